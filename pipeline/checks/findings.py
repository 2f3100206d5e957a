"""The health report of a folder of recordings: each finding with its recording, its figure and the limit.

An `error` is a recording, a label or a wire that is wrong; a model trained on it would learn what is
false. A `warning` is unusual and may be right.

Gravity, the data sheet's noise, mains and drift in g, and the signs of the contact zones are checked of accelerometers
alone. Recordings that are assembled from presses hold and share samples; nothing of them is taken for clipped, copied
or made up. `report.not_checked` says so.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.units import impossible_output
from softslide.pipeline.checks.measurements import MEAN_S, Measurements, measure
from softslide.pipeline.checks.rail_run import MOST_AT_RAIL
from softslide.pipeline.checks.wrong_speeds import impossible_speed
from softslide.pipeline.checks.zone_signs import line_mismatch_mm
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.base_motion import base_motion_of
from softslide.pipeline.recordings.derived_labels import with_derived_labels
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import SAME_LINE_MM, learned_lines
from softslide.pipeline.sensor import NOISE_G_RTHZ, Accelerometer, Sensor

LEAST_SLIDES = 3  # that show what is usual


class Limits:
    """What a figure may be. On the emulated bench recordings each has at least a factor of two to spare."""

    longest_step = 1.1  # samples
    rate = 0.0005  # of the sensor's rate
    swing = 10.0  # standard deviations; 400 means of noise alone range over 6
    rail_run = MOST_AT_RAIL  # equal samples at the highest or lowest reading
    noise_high = 2.0  # times the data sheet
    noise_low = 0.3  # times the data sheet
    mains_g = 0.01  # amplitude
    drift_g = 0.04  # rest after less rest before
    usual_drift_g = 0.002  # the same of V_x and V_y, median over the slides that take longest
    rest_s = 0.5  # before the slide
    gravity_g = 0.3  # of the output at rest, from 1 g
    inverted = -0.4  # mean agreement with the zones
    follows = 0.4  # mean agreement below which an output does not follow its own axis
    swapped = 0.6  # mean agreement with the other's axis
    slide = -0.2  # agreement of one slide with its labels
    # Span of an output, a share of the board's other one, below which its sign is not compared: off the chamber's
    # centre a board's zones begin up to 5 mm next to it (synthetic slides of two, experiments/LOG.md).
    zone_share = 0.5
    # And of the largest span of any output, below which what is compared shows no slide (2,500 sound slides,
    # experiments/LOG.md).
    compared_share = 0.04
    line_mm = 2.0  # start less line
    speed = 0.05  # the motion's duration against travel over speed, as a portion
    ramp_s = 1.0  # or, if more, as a time
    copied = 0.3  # portion of the samples that two recordings share
    same_noise = 0.5  # correlation of two recordings' noise
    same_output = 0.95  # correlation of two outputs' noise at rest; high, as a pump may shake all of them
    echo = 0.3  # autocorrelation of the noise
    tone = 100.0  # power of a line over the noise floor
    equal_noise = 0.02  # spread of the noise between outputs, over what chance would leave


@dataclass(frozen=True)
class Finding:
    """One finding. recording: its name, or "" where it concerns the folder; channel: likewise."""

    level: str
    kind: str
    recording: str
    channel: str
    figure: float
    limit: float
    text: str

    def line(self) -> str:
        """One line for a person."""
        place = " ".join(part for part in (self.recording, self.channel) if part) or "all"
        return f"{self.level}: {self.kind}: {place}: {self.text} ({self.figure:.4g}, limit {self.limit:.4g})"


def measured_slides(folder: Folder) -> tuple[list[Measurements], list[Finding]]:
    """The measurements of every slide that can be read, with the labels that follow from others; and what is refused,
    which the rest leaves out.

    Of a sensor with a base what depends on the robot's attitude is measured without its motion.
    """
    measured, refused, motion = [], [], None
    try:
        motion = base_motion_of(folder)
    except InputError as error:
        refused.append(Finding("error", "base", "", "", 1.0, 0.0, str(error)))
    labels = with_derived_labels(folder).manifest
    for name, row in progress_bar("check", "slide", labels.iterrows(), len(folder)):
        try:
            recording = folder.read(str(name))
            upright = None if motion is None else recording.without(motion, folder.root / row["file"])
            measured.append(measure(recording, row, folder.sensor, upright))
        except InputError as error:
            refused.append(Finding("error", "unreadable", str(name), "", 1.0, 0.0, str(error)))
    return measured, refused


def compared(folder: Folder, measured: Sequence[Measurements], refused: Sequence[Finding]) -> list[Finding]:
    """The findings on `measured_slides`; errors first. Labels are held against each other as they are given."""
    if not measured:
        return list(refused)
    manifest = folder.manifest.loc[[one.name for one in measured]]
    findings = list(_wiring(measured, folder.sensor))
    sound = not any(finding.level == "error" for finding in findings)
    findings += _drifting(measured, manifest, folder.sensor)
    units = list(_units(measured, folder))
    wrong_boards = {unit.channel for unit in units if unit.kind == "unit"}
    if wrong_speed := any((unit.level, unit.kind) == ("error", "speed") for unit in units):
        # Where the object is, and so which sign is due, follows from the speed.
        findings, sound = [], False
    quiet = _quiet(measured, folder.sensor)
    for one, (_, labels) in zip(measured, manifest.iterrows(), strict=True):
        findings += _signal(one, folder.sensor, quiet)
        findings += _labels(one, labels, folder.sensor)
        if sound:
            # A wrong wire makes every slide disagree with its labels; it is reported once, above.
            findings += _label_against_signal(one, folder.sensor)
    if folder.sensor.origin != "assembled":
        copies = list(_duplicates(measured))
        findings += copies
        copied = {finding.recording for finding in copies}
        findings += _made_up([one for one in measured if one.name not in copied], folder.sensor)
    findings += _leakage(with_derived_labels(folder).manifest.loc[manifest.index])

    def is_explained(finding: Finding) -> bool:
        """Whether a wrong unit is why: it is reported once."""
        if finding.kind in ("gravity", "noise", "mains", "drift"):
            return (finding.channel.rpartition("_v")[0] or finding.channel) in wrong_boards
        return finding.kind == "labels" and wrong_speed

    others = (finding for finding in findings if not is_explained(finding))
    return sorted([*refused, *units, *others], key=lambda finding: finding.level)


def _units(measured: Sequence[Measurements], folder: Folder) -> Iterator[Finding]:
    """Outputs and speeds in a unit that is not theirs, of the folder as a whole."""
    for k, part in enumerate(folder.sensor.accelerometers):
        rest = np.array([one.rest_v[3 * k : 3 * k + 3] for one in measured])
        rest = rest[np.isfinite(rest).all(axis=1)]
        if len(rest) and (text := impossible_output(np.median(rest, axis=0), asdict(part))):
            off = abs(np.linalg.norm(np.median(rest, axis=0) - part.zero_g_v) / part.sensitivity_v_per_g - 1)
            yield Finding("error", "unit", "", part.name, float(off), Limits.gravity_g, text)
    factor, text = impossible_speed(folder.manifest, folder.sensor)
    if text:
        # Where no label gives the way, it may be a short one.
        level = "error" if folder.manifest["travel_mm"].notna().any() else "warning"
        yield Finding(level, "speed", "", "", factor, 1.0, text)


def _quiet(measured: Sequence[Measurements], sensor: Sensor) -> np.ndarray:
    """(C,) bool: outputs that work, whose noise is less than a step of the converter: one may not change by itself."""
    density, span_v = (
        np.array([getattr(one, name) for one in measured]) for name in ("noise_v_rthz", "span_v")
    )
    noise_v = np.median(density, axis=0) * np.sqrt(sensor.sample_rate_hz / 2)
    return (noise_v < sensor.adc_step_v) & (np.median(span_v, axis=0) > sensor.adc_step_v)


def _signal(one: Measurements, sensor: Sensor, quiet: np.ndarray) -> Iterator[Finding]:
    """One recording's own signal: clock, rest, gravity, and each output's. quiet: see `_quiet`."""
    off = abs(one.rate_hz / sensor.sample_rate_hz - 1)
    yield from _above(
        *(one, ""),
        ("warning", "clock", one.longest_step, Limits.longest_step, "the longest step, in samples"),
        ("warning", "clock", off, Limits.rate, "the rate is off sample_rate_hz by this portion"),
    )
    if one.rest_s < Limits.rest_s:
        text = "s of rest before the slide"
        yield Finding("warning", "no rest", one.name, "", float(one.rest_s), Limits.rest_s, text)
    for k, part in enumerate(sensor.accelerometers):
        if part.measures_gravity:
            rest_g = (one.rest_v[3 * k : 3 * k + 3] - part.zero_g_v) / part.sensitivity_v_per_g
            off, text = abs(float(np.linalg.norm(rest_g)) - 1), "g off the 1 g that is due at rest"
            yield from _above(one, part.name, ("warning", "gravity", off, Limits.gravity_g, text))
        for n in range(3 * k, 3 * k + 3):
            channel, span_v = sensor.channels[n], float(one.span_v[n])
            if span_v <= sensor.adc_step_v:
                text = f"{part.unit} between highest and lowest"
                if not quiet[n]:
                    yield Finding("error", "dead", one.name, channel, span_v, sensor.adc_step_v, text)
                continue
            if part.measures_gravity:
                yield from _acceleration(one, n, channel, part)
            if sensor.origin != "assembled":
                yield from _output(one, n, channel)


def _acceleration(one: Measurements, n: int, channel: str, part: Accelerometer) -> Iterator[Finding]:
    """One output of an accelerometer, in g: noise, mains, drift. n: of its channel."""
    noise, mains, drift = (
        v[n] / part.sensitivity_v_per_g for v in (one.noise_v_rthz, one.mains_v, np.abs(one.drift_v))
    )
    sheet = NOISE_G_RTHZ.get(part.model, np.nan)
    high, low = Limits.noise_high * sheet, Limits.noise_low * sheet
    yield from _above(
        *(one, channel),
        ("warning", "noise", noise, high, f"g/sqrt(Hz), more than the {part.model} has"),
        ("warning", "mains", mains, Limits.mains_g, f"g at {one.mains_hz:g} Hz"),
        ("warning", "drift", drift, Limits.drift_g, "g between rest before and after"),
    )
    if noise < low:
        text = f"g/sqrt(Hz), less than any {part.model} has"
        yield Finding("warning", "noise", one.name, channel, float(noise), float(low), text)


def _output(one: Measurements, n: int, channel: str) -> Iterator[Finding]:
    """One output's signal, whatever it measures: clipped, tones, repeats. n: of its channel."""
    tone = f"times the noise floor at {one.tone_hz[n]:g} Hz: a pure tone, a machine's or a program's"
    twin = "correlation of its noise at rest with another output's: a generator's, repeated"
    yield from _above(
        *(one, channel),
        ("error", "clipped", one.rail_run[n], Limits.rail_run, "equal samples at a rail"),
        ("warning", "tone", one.tone_ratio[n], Limits.tone, tone),
        ("error", "made up", one.echo[n], Limits.echo, "the noise repeats itself"),
        ("warning", "made up", one.twin[n], Limits.same_output, twin),
    )


def _above(one: Measurements, channel: str, *rows: tuple[str, str, float, float, str]) -> Iterator[Finding]:
    """Those of a recording whose figure exceeds the limit: level, kind, figure, limit and text each."""
    for level, kind, figure, limit, text in rows:
        if figure > limit:
            yield Finding(level, kind, one.name, channel, float(figure), float(limit), text)


def _labels(one: Measurements, labels: pd.Series, sensor: Sensor) -> Iterator[Finding]:
    """Labels that contradict each other, or a signal that shows nothing of the slide."""
    touched = [channel[-1] in sensor.touch_axes for channel in sensor.channels]
    if labels["direction_deg"] >= 0.0 and (swing := float(one.swing[touched].max())) < Limits.swing:
        text = f"times the noise between its means of {MEAN_S:g} s: nothing shows of this slide"
        yield Finding("warning", "no contact", one.name, "", swing, Limits.swing, text)
    duration = labels["motion_end_s"] - labels["motion_start_s"]
    due = labels["travel_mm"] / labels["speed_mm_s"]
    # A stage takes its time to speed up and to stop; that does not contradict its label.
    ramps = max(Limits.ramp_s, Limits.speed * due)
    line = "mm between the start and the line of direction and offset"
    moments = "s between the moments of motion and travel over speed"
    yield from _above(
        *(one, ""),
        ("error", "labels", abs(line_mismatch_mm(labels, sensor)), Limits.line_mm, line),
        ("error", "labels", abs(duration - due), ramps, moments),
    )


def _label_against_signal(one: Measurements, sensor: Sensor) -> Iterator[Finding]:
    """Slides whose signs disagree with their labels: forward labelled as backward, an offset without its sign."""
    for k, part in enumerate(sensor.accelerometers):
        if not part.measures_gravity:
            continue
        agreement, channels = one.agreement[k], [f"{part.name}_v{axis}" for axis in "xy"]
        own, span_v = agreement[:2].diagonal().tolist(), one.span_v[3 * k : 3 * k + 2]
        shows = one.compared_v[k, :2].diagonal() > Limits.compared_share * one.span_v.max()
        for i, channel in enumerate(channels):
            if own[i] < Limits.slide and shows[i] and span_v[i] > Limits.zone_share * span_v[1 - i]:
                text = "agreement with the zones due for direction and offset: another slide than labelled"
                yield Finding("error", "label against signal", one.name, channel, own[i], Limits.slide, text)
        if (np.nan_to_num(own) > Limits.follows).any():
            continue  # What follows both axes does so by chance, on a diagonal.
        swapped = [i for i in (0, 1) if agreement[1 - i, i] > Limits.swapped and not np.isnan(own[i])]
        for i in swapped[:1]:
            text = (
                f"agreement with its axis, which {channels[1 - i]} follows instead: x and y are swapped here"
            )
            yield Finding("error", "swapped", one.name, channels[i], own[i], Limits.follows, text)


def _wiring(measured: Sequence[Measurements], sensor: Sensor) -> Iterator[Finding]:
    """Outputs inverted, swapped or not following, over all labelled slides; and z against gravity."""
    for k, part in enumerate(sensor.accelerometers):
        if not part.measures_gravity:
            continue
        upright = (
            np.array([one.rest_v[3 * k + 2] - part.zero_g_v for one in measured]) / part.sensitivity_v_per_g
        )
        if not np.isnan(upright).all() and (z_g := float(np.nanmedian(upright))) < -0.5:
            yield Finding("error", "inverted", "", f"{part.name}_vz", z_g, -0.5, "g at rest, where +1 is due")
        agreement = np.array([one.agreement[k] for one in measured])
        if (np.isfinite(agreement).sum(axis=0).diagonal() < LEAST_SLIDES).any():
            continue
        mean = np.nanmean(agreement, axis=0)
        for i, axis in enumerate("xy"):
            channel, own = f"{part.name}_v{axis}", float(mean[i, i])
            others = [j for j in range(3) if j != i and abs(mean[j, i]) > Limits.swapped]
            if abs(own) < Limits.follows and others:
                text = f"mean agreement with its axis, which {part.name}_v{'xyz'[others[0]]} follows instead"
                yield Finding("error", "swapped", "", channel, own, Limits.follows, text)
            elif own < Limits.inverted:
                text = "mean agreement with the article's zones: its sign is inverted"
                yield Finding("error", "inverted", "", channel, own, Limits.inverted, text)
            elif own < Limits.follows:
                text = "mean agreement with the article's zones: it does not follow the slides"
                yield Finding("error", "dead", "", channel, own, Limits.follows, text)


def _drifting(measured: Sequence[Measurements], manifest: pd.DataFrame, sensor: Sensor) -> Iterator[Finding]:
    """Outputs along the skin's plane that drift in most long slides: each is learned with a zero that moves."""
    drift_v = np.array([np.abs(one.drift_v) for one in measured])
    known = np.isfinite(drift_v).all(axis=1)
    if known.sum() < LEAST_SLIDES:
        return
    # A zero that creeps shows in slow slides, and spoils them alone. Without a start the rest is the recording's first.
    lasts_s = (manifest["motion_end_s"] - manifest["motion_start_s"].fillna(0.0)).to_numpy(float)
    drift_v = drift_v[known & (lasts_s >= np.median(lasts_s[known]))]
    for k, part in enumerate(sensor.accelerometers):
        for n in (0, 1) if part.measures_gravity else ():
            drift_g = float(np.median(drift_v[:, 3 * k + n])) / part.sensitivity_v_per_g
            if drift_g > Limits.usual_drift_g:
                slides = f"the {len(drift_v)} longest slides"
                text = f"g between rest before and after, median of {slides}: a warm-up may help"
                channel = sensor.channels[3 * k + n]
                yield Finding("warning", "drift", "", channel, drift_g, Limits.usual_drift_g, text)


def _duplicates(measured: Sequence[Measurements]) -> Iterator[Finding]:
    """Recordings that hold the samples of an earlier one to the last bit, wherever they begin."""
    owner: dict[int, int] = {}
    for n, one in enumerate(measured):
        owners = [owner.setdefault(int(mark), n) for mark in one.landmarks]
        for m, count in Counter(m for m in owners if m != n).most_common(1):
            share = count / min(len(one.landmarks), len(measured[m].landmarks))
            if share > Limits.copied:
                text = f"of its samples, or of the other's, are those of {measured[m].name} to the last bit"
                yield Finding("error", "duplicate", one.name, "", share, Limits.copied, text)


def _made_up(measured: Sequence[Measurements], sensor: Sensor) -> Iterator[Finding]:
    """Noise that two recordings share, and outputs whose noise is equal beyond chance."""
    whole = [one for one in measured if len(one.fingerprint) == max(len(v.fingerprint) for v in measured)]
    outputs = len(sensor.channels)
    noise = np.concatenate([one.fingerprint.T for one in whole])
    for b in range(1, len(noise)):
        own = b - b % outputs
        shared = np.abs(noise[:own] @ noise[b])
        one, channel = whole[b // outputs], sensor.channels[b % outputs]
        if own and (figure := float(shared.max())) > Limits.same_noise:
            other = whole[int(shared.argmax()) // outputs].name
            text = f"correlation of its noise with that of {other}: a generator's, repeated"
            yield Finding("error", "made up", one.name, channel, figure, Limits.same_noise, text)
    variance = np.array([one.noise_v_rthz**2 for one in measured if np.isfinite(one.noise_v_rthz).all()])
    if len(variance) < 5:
        return
    chance = variance.std(axis=0, ddof=1).mean() / np.sqrt(len(variance))
    spread = variance.mean(axis=0).std(ddof=1)
    relative = float(spread / variance.mean())
    if relative < Limits.equal_noise and spread < 2 * chance:
        text = "spread of the noise's variance between outputs, no more than chance leaves; real ones differ"
        yield Finding("warning", "made up", "", "", relative, Limits.equal_noise, text)


def _leakage(manifest: pd.DataFrame) -> Iterator[Finding]:
    """Leakage: a line of the same direction and offset in a calibration and in a test split."""
    learned, offset_mm = learned_lines(manifest), manifest["offset_mm"].astype(float)
    for name in manifest.index[manifest["split"].str.startswith("test")]:
        if line := learned[name]:
            text = f"mm from the line of {line}, which is in a calibration split: 'evaluate' scores it apart"
            off = abs(offset_mm[name] - offset_mm[line])
            yield Finding("warning", "leakage", str(name), "", off, SAME_LINE_MM, text)

"""The onset of slides whose labels leave it out: found in the signal, along the line that the labels name.

With direction, speed and offset known, one number of a slide is missing: when its contact passes the foot of the
perpendicular from the reference point. A matched filter (Turin 1960) with the design's output along the line finds it
to about 0.5 mm; the design's parameters and the onsets are then fitted in turn, and the calibration goes on from there.
A common delay of all slides looks like more friction, to first order: the design's friction and the chamber's rim, at
which the response ends, keep the two apart.
"""

from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.features.angles import tilt_channels
from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.models.response_map.from_atlas import SensorSpread, prior_map
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.slide_fit import CalibrationConfig, fit_slide
from softslide.models.response_map.slides import LABELS, calibration_slides, means, stretch_blocks
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.derived_labels import UNTIMED
from softslide.pipeline.recordings.folder import Folder, Recording
from softslide.pipeline.synthesis.slide_plan import chord

ONSET_ROUNDS = 3  # of the design's parameters and the onsets in turn
REST_S = 0.5  # the static output is read from the recording's first half second
RUN_UP_MM = 4.0  # the motion is taken to start and end so far outside the chamber, where nothing answers yet


def with_onsets(
    folder: Folder,
    atlas: Atlas | None,
    conditioning: Conditioning,
    spread: SensorSpread,
    config: CalibrationConfig,
) -> tuple[Folder, dict[str, str]]:
    """The folder with start, travel and moments of motion of those slides too that lack some of them, UNTIMED of
    these; and why a recording has no place, by name.

    Labelled moments are kept. Without a start the slide is taken to cross the chamber from rim to rim at its speed.
    Without an atlas the signal's energy is taken to be centred at the accelerometers, which is good to a few mm.
    """
    known = folder.manifest[list(LABELS)].notna().all(axis=1)
    table, left_out = folder.manifest.assign(**{UNTIMED: ~known}), dict[str, str]()
    if known.all():
        return replace(folder, manifest=table), left_out
    depth_mm = float(folder.manifest["depth_mm"].median())
    sensor = folder.sensor.scaled(conditioning.scale)
    response = None if atlas is None else prior_map(atlas, sensor, [], depth_mm, spread)[0]
    for name in folder.manifest.index[~known]:
        row, recording = folder.manifest.loc[name], folder.load(name)
        passing = _passing_s(folder, recording, row, conditioning, response)
        if passing is None:
            left_out[str(name)] = f"no output of {1e3 * conditioning.trigger_v:g} mV to find its onset by"
        else:
            placed = _placed(folder, recording, row, passing)
            table.loc[name, list(placed)] = list(placed.values())
    folder = replace(folder, manifest=table)
    if atlas is None:
        return folder, left_out
    # The onsets are fitted to the design's map, and its parameters to the slides, in turn.
    for _ in range(ONSET_ROUNDS):
        slides = calibration_slides(folder, conditioning)
        if not slides:
            break
        depth_mm = float(np.median([slide.depth_mm for slide in slides]))
        response, _ = prior_map(atlas, sensor, slides, depth_mm, spread)
        untimed = [slide for slide in slides if not slide.timed]
        response = replace(response, lag_s=0.0) if len(untimed) == len(slides) else response
        folder = moved(folder, {s.recording: fit_slide(s, response, config).shift_mm for s in untimed})
    return folder, left_out


def moved(folder: Folder, shift_mm: dict[str, float]) -> Folder:
    """Slides set back along their lines by so much: the moments of motion stay, the place at them changes."""
    table = folder.manifest.copy()
    for name, shift in shift_mm.items():
        a = np.deg2rad(float(table["direction_deg"][name]))
        table.loc[name, ["start_x_mm", "start_y_mm"]] -= shift * np.array([np.cos(a), np.sin(a)])
    return replace(folder, manifest=table)


def _passing_s(
    folder: Folder,
    recording: Recording,
    row: pd.Series,
    conditioning: Conditioning,
    response: ResponseMap | None,
) -> float | None:
    """When the contact passes the foot of the perpendicular, s; None where no output reaches the trigger.

    response: predicts the output along the line, the filter's template; without it the signal's energy is taken to be
    centred at the accelerometers.
    """
    tilt = tilt_channels(recording.volts.shape[1])
    blocks = block_means(recording.volts, conditioning, folder.sensor.sample_rate_hz)[:, tilt]
    rest = blocks[: max(1, round(REST_S / conditioning.block_s))].mean(axis=0)
    count = stretch_blocks(row["speed_mm_s"], conditioning.block_s)
    output, stretch_mm = means(blocks, count) - rest, count * conditioning.block_s * row["speed_mm_s"]
    if np.abs(output).max() < conditioning.trigger_v:
        return None
    along, left = _axes(row)
    reference = np.array(folder.sensor.reference_mm)
    if response is None:
        energy = (output**2).sum(axis=1)
        boards = np.array([(a.x_mm, a.y_mm) for a in folder.sensor.accelerometers]).mean(axis=0)
        passed = (energy @ np.arange(len(output))) / energy.sum() - along @ (boards - reference) / stretch_mm
    else:
        s = np.arange(-2 * response.half_mm, 2 * response.half_mm, stretch_mm)
        x, y = (reference + row["offset_mm"] * left)[:, None] + s * along[:, None]
        template = response.response(x, y, np.deg2rad(row["direction_deg"]))
        likeness = sum(np.correlate(o, t, "full") for o, t in zip(output.T, template.T, strict=True))
        passed = int(np.argmax(likeness)) - (len(s) - 1) - s[0] / stretch_mm
    return float(recording.time_s[0] + (passed + 0.5) * stretch_mm / row["speed_mm_s"])


def _placed(folder: Folder, recording: Recording, row: pd.Series, passing_s: float) -> dict[str, float]:
    """Start, travel and moments of a slide that passes the foot at a moment."""
    along, left = _axes(row)
    reference, speed = np.array(folder.sensor.reference_mm), row["speed_mm_s"]
    foot = reference + row["offset_mm"] * left
    # A line that misses the chamber stands at its foot.
    begin, end = chord(foot, along, np.array(folder.sensor.chamber_mm) / 2 + RUN_UP_MM) or (0.0, 0.0)
    if row[["motion_start_s", "motion_end_s"]].notna().all():
        start_s, end_s = row["motion_start_s"], row["motion_end_s"]
    else:
        if row[["start_x_mm", "start_y_mm"]].notna().all():
            begin = along @ (row[["start_x_mm", "start_y_mm"]].to_numpy(float) - reference)
            end = end if np.isnan(row["travel_mm"]) else begin + row["travel_mm"]
        start_s = max(passing_s + begin / speed, recording.time_s[0] + REST_S)
        end_s = min(passing_s + end / speed, recording.time_s[-1])
    start = foot + speed * (start_s - passing_s) * along
    return {
        "start_x_mm": start[0],
        "start_y_mm": start[1],
        "travel_mm": speed * (end_s - start_s),
        "motion_start_s": start_s,
        "motion_end_s": end_s,
    }


def _axes(row: pd.Series) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (2,) along the motion and to its left."""
    a = np.deg2rad(row["direction_deg"])
    return np.array([np.cos(a), np.sin(a)]), np.array([-np.sin(a), np.cos(a)])

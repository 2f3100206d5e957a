"""What the tracker's constants are worth: each of them halved and doubled, on calibration slides, presses and jumps.

Run with `python -m experiments.studies.tracker_constants bench-a`; takes minutes. The slides are every fourth of the
folder's calibration recordings; the presses and the stops are synthetic, made here; a jump is a step of 30 mV put into
a recording's rest. For each setting it prints how many slides are lost (no slide seen) or split (more than one seen),
in how many of the presses a slide is seen, how many stops are missed, and after how many presses and jumps the static
output is wrong by more than `WRONG_V`.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import features.stream.tracker
from features.stream.conditioning import Conditioning, block_means
from features.stream.tracker import SlideState, SlideTracker
from pipeline.atlas.atlas import read_atlas
from pipeline.progress import progress_bar
from pipeline.recordings.folder import read_folder
from pipeline.synthesis.distribution import Distribution
from pipeline.synthesis.paths.draw import draw_path
from pipeline.synthesis.specimen import draw_specimen
from pipeline.synthesis.synthesize import noise_of, plan, record, sensor_of

COUNT = 20
JUMP_V = 0.03
WRONG_V = 0.003
FACTORS = (0.5, 2.0)
MODULE = ("TOUCH_CHANGE", "TOUCH_TRIGGER", "STRONG_TRIGGERS", "STRONG_TOUCH", "JUMP_SHARE")
FIELDS = ("still_share", "still_change", "still_peak_v", "least_blocks", "touch_blocks")

Stream = np.ndarray  # block means (m, C) V


def streams_of(root: Path, conditioning: Conditioning) -> dict[str, list[Stream]]:
    """Slides, presses, stops and jumps as block means."""
    folder = read_folder(root).select("calibration")
    rate = folder.sensor.sample_rate_hz
    slides = [block_means(folder.load(name).volts, conditioning, rate) for name in folder.manifest.index[::4]]
    rest = int(0.8 / conditioning.block_s)
    jumps = []
    for slide in slides[:COUNT]:
        still = slide[np.arange(400) % rest]
        still[200:, 0] += JUMP_V
        jumps.append(still)
    atlas = read_atlas()
    sensor, stopping = sensor_of(atlas), Distribution(stopping=1.0, turning=0.0)
    specimen = draw_specimen(sensor, Distribution(), 0)
    presses, stops = [], []
    for n in range(COUNT):
        press = draw_path(n, atlas, sensor, Distribution(), np.random.default_rng([0, n]), kind="press")
        presses.append(record(press, specimen, atlas, noise_of(n, 0)).volts)
        stops.append(record(plan(n, 0, atlas, sensor, stopping), specimen, atlas, noise_of(n, 1)).volts)
    made = {
        kind: [block_means(volts, conditioning, sensor.sample_rate_hz) for volts in of]
        for kind, of in {"presses": presses, "stops": stops}.items()
    }
    return {"slides": slides, "jumps": jumps, **made}


def seen(stream: Stream, conditioning: Conditioning) -> tuple[int, bool, np.ndarray]:
    """Slides seen in a stream; whether one still runs at its end; the static output (C,) V then."""
    tracker = SlideTracker(conditioning, stream.shape[1])
    count, before = 0, False
    for block in stream:
        tracker.push(block)
        moving = tracker.state is SlideState.SLIDE and tracker.moved
        count, before = count + (moving and not before), moving
    return count, before, tracker.static.copy()


def score(streams: dict[str, list[Stream]], conditioning: Conditioning) -> str:
    """One setting's figures, as text."""
    slides = [seen(stream, conditioning)[0] for stream in streams["slides"]]
    presses = [(stream, *seen(stream, conditioning)) for stream in streams["presses"]]
    stops = [seen(stream, conditioning)[1] for stream in streams["stops"]]
    jumps = [(stream, seen(stream, conditioning)[2]) for stream in streams["jumps"]]
    figures = {
        "slides lost": sum(n == 0 for n in slides),
        "split": sum(n > 1 for n in slides),
        "slides seen in presses": sum(n > 0 for _, n, _, _ in presses),
        "static output wrong after presses": sum(
            np.abs(static - stream[:20].mean(axis=0)).max() > WRONG_V for stream, _, _, static in presses
        ),
        "after jumps": sum(
            np.abs(static - stream[-20:].mean(axis=0)).max() > WRONG_V for stream, static in jumps
        ),
        "stops missed": sum(stops),
    }
    return ", ".join(f"{name} {count}" for name, count in figures.items())


def settings(conditioning: Conditioning) -> Iterator[tuple[str, Conditioning]]:
    """Each setting's name; while it is current, the module's constant is the setting's."""
    yield "as they are", conditioning
    for factor in FACTORS:
        for name in MODULE:
            value = getattr(features.stream.tracker, name)
            setattr(features.stream.tracker, name, value * factor)
            yield f"{name} {value * factor:g}", conditioning
            setattr(features.stream.tracker, name, value)
        for name in FIELDS:
            value = type(getattr(conditioning, name))(getattr(conditioning, name) * factor)
            yield f"{name} {value:g}", replace(conditioning, **{name: value})


def main(root: Path) -> None:
    conditioning = Conditioning()
    streams = streams_of(root, conditioning)
    print(", ".join(f"{len(of)} {kind}" for kind, of in streams.items()))
    for name, changed in progress_bar("settings", "setting", settings(conditioning), 21):
        print(f"{name}: {score(streams, changed)}", flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""What the tracker's constants are worth: each of them halved and doubled, on slides, presses, stops and jumps.

The slides are every fourth of the folder's calibration recordings; presses and stops are synthetic, made here; a jump
is a step of 30 mV put into a recording's rest. Prints for each setting how many slides are lost (no slide seen) or
split (more than one seen), in how many presses a slide is seen, how many stops are missed, and after how many presses
and jumps the static output is wrong by more than 3 mV. Minutes on one core.

    python -m softslide.experiments.studies.tracker_constants --recordings bench-a
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from softslide.experiments.studies.script import Part, parser, recordings, run
from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.features.stream.tracker import SlideState, SlideTracker
from softslide.pipeline.atlas.atlas import read_atlas
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.paths.draw import draw_path
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.specimen import draw_specimen
from softslide.pipeline.synthesis.synthesize import noise_of, plan, record, sensor_of

COUNT = 20
REST_S = 0.8
JUMP_V, WRONG_V = 0.03, 0.003
FACTORS = (0.5, 2.0)
CONSTANTS = ("still_share", "still_change", "still_peak_v", "least_blocks", "touch_blocks")

Stream = np.ndarray  # block means (m, C) V


def streams_of(folder: Folder, conditioning: Conditioning) -> dict[str, list[Stream]]:
    """Slides, jumps, presses and stops as block means."""
    rate = folder.sensor.sample_rate_hz
    slides = [block_means(folder.load(name).volts, conditioning, rate) for name in folder.manifest.index[::4]]
    rest = np.arange(400) % int(REST_S / conditioning.block_s)
    step = JUMP_V * (np.arange(400) >= 200)[:, None] * (np.arange(slides[0].shape[1]) == 0)
    atlas = read_atlas()
    sensor, stopping = sensor_of(atlas), Distribution(stopping=1.0, turning=0.0)
    specimen = draw_specimen(sensor, Distribution(), 0)

    def blocks(drawn: Slide | ContactPath, noise: np.random.Generator) -> Stream:
        return block_means(record(drawn, specimen, atlas, noise).volts, conditioning, sensor.sample_rate_hz)

    drawn = (atlas, sensor, Distribution())
    presses = [draw_path(n, *drawn, np.random.default_rng([0, n]), kind="press") for n in range(COUNT)]
    return {
        "slides": slides,
        "jumps": [slide[rest] + step for slide in slides[:COUNT]],
        "presses": [blocks(press, noise_of(n, 0)) for n, press in enumerate(presses)],
        "stops": [blocks(plan(n, 0, atlas, sensor, stopping), noise_of(n, 1)) for n in range(COUNT)],
    }


def seen(stream: Stream, conditioning: Conditioning) -> tuple[int, bool, np.ndarray]:
    """Slides seen in a stream; whether one still runs at its end; the static output (C,) V then."""
    tracker = SlideTracker(conditioning, stream.shape[1])
    count, before = 0, False
    for block in stream:
        tracker.push(block)
        moving = tracker.state is SlideState.SLIDE and tracker.moved
        count, before = count + (moving and not before), moving
    return count, before, tracker.static.copy()


def score(streams: dict[str, list[Stream]], conditioning: Conditioning) -> dict[str, float]:
    """One setting's figures."""
    found = {kind: [seen(stream, conditioning) for stream in of] for kind, of in streams.items()}

    def wrong(kind: str, rest: slice) -> int:
        true_v = [stream[rest].mean(axis=0) for stream in streams[kind]]
        return sum(np.abs(f[2] - v).max() > WRONG_V for f, v in zip(found[kind], true_v, strict=True))

    return {
        "slides_lost": sum(count == 0 for count, _, _ in found["slides"]),
        "slides_split": sum(count > 1 for count, _, _ in found["slides"]),
        "slides_seen_in_presses": sum(count > 0 for count, _, _ in found["presses"]),
        "stops_missed": sum(runs for _, runs, _ in found["stops"]),
        "static_output_wrong_after_presses": wrong("presses", slice(20)),
        "static_output_wrong_after_jumps": wrong("jumps", slice(-20, None)),
    }


def constants(folder: Folder, conditioning: Conditioning) -> Iterator[Part]:
    """The figures of the tracker as it is, then with each of CONSTANTS times each of FACTORS."""
    streams = streams_of(folder, conditioning)
    yield "as they are", score(streams, conditioning)
    for factor in FACTORS:
        for name in CONSTANTS:
            value = type(getattr(conditioning, name))(getattr(conditioning, name) * factor)
            yield f"{name} {value:g}", score(streams, replace(conditioning, **{name: value}))


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("tracker_constants", __doc__)
    recordings(words, "its calibration slides are read")

    def study(given: argparse.Namespace) -> Iterator[Part]:
        return constants(read_folder(given.recordings).select("calibration"), Conditioning())

    return run(words, study, argv)


if __name__ == "__main__":
    sys.exit(main())

"""How often a bundle takes a signal without any contact for a slide.

Reads synthetic streams of a sensor that nothing touches, of 13 kinds: at rest; the device tilted, rocked and swayed;
its pressure changed; waves, bumps, chirps, random walks, drifts, steps and taps of 5 to 300 mV. V_z stays in every
second stream of the latter. A sensor without accelerometers has the kinds that add to its outputs, as large for it, and
the bundle's noise. Prints for each kind the time (s) for which something seemed to slide, the share of it (%) with a
valid estimate, and how many streams have one. A second of signal takes about 50 ms.

    python -m softslide.experiments.studies.false_alarms --model my-model --recordings my-recordings
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from softslide.experiments.evaluation.readout import check_fits, open_localizer
from softslide.experiments.studies.script import Part, bundle, count, parser, recordings, run
from softslide.features.errors import InputError
from softslide.features.stream.tracker import SlideState
from softslide.pipeline.recordings.at_rest import REFERENCE_V_PER_G
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.no_contact import OF_ACCELEROMETERS, SIGNALS, disturbed, untouched
from softslide.pipeline.workers import results

# Of a recording without labelled moments its beginning is taken for rest.
REST_S = 0.2


def false_alarms(
    bundle: Path, folder: Folder, streams: int = 12, seconds: float = 25.0, seed: int = 0, jobs: int = 1
) -> Iterator[Part]:
    """For each kind of SIGNALS `tracked_s`, time for which something seemed to slide; `valid_percent`, the share of it
    with a valid estimate, NaN without any; `streams_with_any` of the `streams` have one.

    folder: of the bundle's sensor; its first recording gives the static output. seconds: of each signal.
    jobs: processes.

    Raises:
        InputError: the bundle is not valid, does not fit the folder, has no response map where the sensor
            is without accelerometers, or reads a base: no such streams are made of these.
    """
    localizer = open_localizer(bundle)
    check_fits(localizer.card, folder)
    if not folder.sensor.measures_gravity and localizer.card.contact is None:
        raise InputError(
            f"{bundle}: has no response map, and with it no noise of such outputs; name one that has"
        )
    if localizer.card.base is not None:
        raise InputError(f"{bundle}: reads a base, of which no streams are made; name a bundle without one")
    static_v, block_s = _static(folder), localizer.card.conditioning.block_s
    others = () if folder.sensor.measures_gravity else OF_ACCELEROMETERS
    for kind in (kind for kind in SIGNALS if kind not in others):
        calls = [(bundle, folder.sensor, static_v, kind, seconds, (seed, n)) for n in range(streams)]
        slid, valid = np.array(list(results(counts, calls, jobs))).T
        share = 100.0 * valid.sum() / slid.sum() if slid.any() else np.nan
        found = {"tracked_s": slid.sum() * block_s, "valid_percent": share}
        yield kind, found | {"streams": streams, "streams_with_any": int(np.count_nonzero(valid))}


def counts(
    bundle: Path, sensor: Sensor, static_v: np.ndarray, kind: str, seconds: float, seed: tuple[int, int]
) -> tuple[int, int]:
    """Of one stream, read as it comes: estimates while something seems to slide, and those of them that are valid."""
    localizer = open_localizer(bundle)
    localizer.reset()
    random = np.random.default_rng([seed[0], list(SIGNALS).index(kind), seed[1]])
    if sensor.measures_gravity:
        volts = untouched(sensor, static_v, SIGNALS[kind], seconds, random)
    else:
        contact, conditioning = localizer.card.contact, localizer.card.conditioning
        assert contact is not None
        samples = conditioning.block_s * sensor.sample_rate_hz
        noise = np.array(contact.noise_v) * math.sqrt(samples) / conditioning.scale
        per_g = REFERENCE_V_PER_G / conditioning.scale
        volts = disturbed(static_v, noise, per_g, SIGNALS[kind], seconds, sensor.sample_rate_hz, random)
    valid = [e.valid for e in localizer.push(volts) if e.state is SlideState.SLIDE]
    return len(valid), sum(valid)


def _static(folder: Folder) -> np.ndarray:
    """The static output (C,) V, before the motion of the first recording."""
    name, row = next(folder.manifest.iterrows())
    recording = folder.load(str(name))
    moves_s = float(row["motion_start_s"])
    before = recording.time_s < (recording.time_s[0] + REST_S if np.isnan(moves_s) else moves_s)
    if not before.any():
        raise InputError(
            f"{folder.root}: recording {name} has no rest before its motion; name another folder"
        )
    static: np.ndarray = recording.volts[before].mean(axis=0)
    return static


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("false_alarms", __doc__)
    bundle(words)
    recordings(words, "of the bundle's sensor")
    count(words, "--streams", 12, "streams of each kind")
    count(words, "--seconds", 25, "of each signal")
    count(words, "--seed", 0, "of all that is random", least=0)
    count(words, "--jobs", 1, "streams that are read at a time")

    def study(g: argparse.Namespace) -> Iterator[Part]:
        return false_alarms(g.model, read_folder(g.recordings), g.streams, g.seconds, g.seed, g.jobs)

    return run(words, study, argv)


if __name__ == "__main__":
    sys.exit(main())

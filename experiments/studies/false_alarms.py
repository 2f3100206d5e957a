"""How often a bundle takes for a contact what is none: synthetic streams of a sensor that nothing touches."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.evaluation.readout import check_fits, open_localizer
from experiments.provenance import bundle_hash, data_tags
from experiments.tracking.study import tracked_study
from features.errors import InputError
from features.stream.tracker import SlideState
from pipeline.progress import progress_bar
from pipeline.recordings.folder import Folder, read_folder
from pipeline.sensor import Sensor
from pipeline.synthesis.no_contact import SIGNALS, untouched
from pipeline.workers import results

# Of a recording without labelled moments its beginning is taken for rest.
REST_S = 0.2


class Stream(NamedTuple):
    """One stream to read: its kind and number, how long its signal lasts, and what the sensor shows at rest (C,) V."""

    kind: str
    number: int
    seconds: float
    seed: int
    sensor: Sensor
    static_v: np.ndarray


class Counts(NamedTuple):
    """Estimates of one stream while something seems to slide, and those of them that are valid."""

    kind: str
    tracked: int
    valid: int


def false_alarms(
    bundle: Path,
    recordings: Path,
    streams: int = 12,
    seconds: float = 25.0,
    seed: int = 0,
    jobs: int = 1,
    store: str | None = None,
) -> dict[str, dict[str, float]]:
    """Reads `streams` streams of each kind of `SIGNALS`, logged as a run with one below it a kind.

    recordings: a folder of the bundle's sensor, whose first recording tells the static output. seconds: of each signal.
    jobs: processes. store: as in `tracking.store.store_address`.

    Returns:
        For each kind `tracked_s`, time for which something seemed to slide; `valid_percent`, the share of it with a
        valid estimate, NaN without any; `streams_with_any` of the `streams` have one.

    Raises:
        InputError: the bundle or the folder is not valid, they do not fit, or the sensor is of a kind, or the bundle
            reads a base, of which no such streams are made; a number is not positive.
    """
    for name, value in {"streams": streams, "seconds": seconds, "jobs": jobs}.items():
        if not value > 0:
            raise InputError(f"{value}: must be positive", name)
    folder, localizer = read_folder(recordings), open_localizer(bundle)
    check_fits(localizer, folder)
    if not folder.sensor.measures_gravity:
        raise InputError(f"{recordings}: is not of accelerometers; streams of other sensors are not made")
    if localizer.card.base is not None:
        raise InputError(f"{bundle}: reads a base, of which no streams are made; name a bundle without one")
    static_v = _static(folder)
    calls = [
        (bundle, Stream(kind, number, seconds, seed, folder.sensor, static_v))
        for kind in SIGNALS
        for number in range(streams)
    ]
    configuration = {
        "bundle": str(bundle),
        "recordings": str(recordings),
        "streams": streams,
        "seconds": seconds,
        "seed": seed,
    }
    tags = {"bundle": bundle_hash(bundle)} | data_tags(folder)
    name = f"false alarms of {localizer.card.model} on {folder.sensor.name}"
    beside = Path("false-alarms")
    with tracked_study("false-alarms", name, configuration, beside, tags=tags, store=store) as (_, part):
        counted = results(counts, calls, jobs)
        every = list(progress_bar("streams", "stream", counted, len(calls)))
        block_s = localizer.card.conditioning.block_s
        figures = {kind: _figures([c for c in every if c.kind == kind], block_s) for kind in SIGNALS}
        for kind, found in figures.items():
            part(kind, {"signal": kind}, found)
    return figures


def counts(bundle: Path, stream: Stream) -> Counts:
    """Reads one stream as it comes."""
    localizer = open_localizer(bundle)
    localizer.reset()
    random = np.random.default_rng([stream.seed, list(SIGNALS).index(stream.kind), stream.number])
    volts = untouched(stream.sensor, stream.static_v, SIGNALS[stream.kind], stream.seconds, random)
    tracked = [e.valid for e in localizer.push(volts) if e.state is SlideState.SLIDE]
    return Counts(stream.kind, len(tracked), sum(tracked))


def _figures(counted: list[Counts], block_s: float) -> dict[str, float]:
    tracked, valid = sum(c.tracked for c in counted), sum(c.valid for c in counted)
    return {
        "tracked_s": tracked * block_s,
        "valid_percent": 100.0 * valid / tracked if tracked else float("nan"),
        "streams": len(counted),
        "streams_with_any": sum(c.valid > 0 for c in counted),
    }


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

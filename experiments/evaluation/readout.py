"""Runs the device's localizer over recordings and reads its estimate at moments of the stroke.

The localizer sees volts alone. Moments of motion choose, afterwards, which of its estimates are written down.
"""

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.scoring import INTERVALS
from softslide.features.card import Card
from softslide.features.errors import InputError
from softslide.features.estimate import interval_ends
from softslide.pipeline.recordings.folder import Folder, Recording
from softslide.serve.localizer import Localizer

ESTIMATED = (
    *(name for column in INTERVALS for name in (column, *interval_ends(column))),
    "depth_mm",
    "x_mm",
    "y_mm",
)
COLUMNS = ("recording", "stroke_fraction", *ESTIMATED, "valid")
STROKE = tuple(n / 10 for n in range(1, 11))


def moments(row: Mapping[Any, Any], time_s: np.ndarray) -> list[tuple[float, float]]:
    """Stroke fractions and the moments in s to read at; 1.0 at the end where the motion is not labelled."""
    start, end = row["motion_start_s"], row["motion_end_s"]
    if math.isnan(start) or math.isnan(end):
        return [(1.0, float(time_s[-1]))]
    return [(fraction, start + fraction * (end - start)) for fraction in STROKE]


def rows_of(
    localizer: Localizer, recording: Recording, samples: np.ndarray, label: Mapping[Any, Any]
) -> list[dict[str, Any]]:
    """The rows of `predictions.csv`, NaN where not estimated, of a recording that a localizer reads as `samples`: the
    estimate as it stood at each moment, from a fresh start and the samples up to it.

    label: its row of the manifest.
    """
    localizer.reset()
    rows, fed = [], 0
    for fraction, moment in moments(label, recording.time_s):
        # A moment that a sample falls on, give or take the last bit of either, has seen that sample.
        count = int(np.searchsorted(recording.time_s, moment + 1e-9, side="right"))
        localizer.feed(samples[fed:count])
        fed = max(fed, count)
        estimate = localizer.read()
        row = {"recording": recording.name, "stroke_fraction": fraction}
        rows.append(row | {column: getattr(estimate, column) for column in COLUMNS[2:]})
    return rows


def predictions(bundle: Path, folder: Folder, archive: Archive) -> Iterator[pd.DataFrame]:
    """The recordings' rows in the manifest's order, some recordings at a time.

    Raises:
        InputError: the bundle is broken or made for another sensor, or a recording is.
    """
    check_fits(open_localizer(bundle).card, folder)
    yield from archive.tables("predictions", _read_out, bundle, folder)


def _read_out(bundle: Path, folder: Folder) -> pd.DataFrame:
    localizer, rows = open_localizer(bundle, folder.sensor.sample_rate_hz), []
    for name in folder.manifest.index:
        recording = folder.read(name)
        samples, label = samples_for(localizer, recording), folder.manifest.loc[name].to_dict()
        rows += rows_of(localizer, recording, samples, label)
    return pd.DataFrame(rows, columns=list(COLUMNS))


def samples_for(localizer: Localizer, recording: Recording) -> np.ndarray:
    """The recording's samples (n, `Card.columns`) V."""
    return recording.volts if localizer.card.base is None else recording.samples


def check_fits(card: Card, folder: Folder) -> None:
    """Sees that the bundle was made for sensors like the folder's.

    Raises:
        InputError: other channels, no base where the bundle reads one, or a sample rate that is not read.
    """
    sensor = folder.sensor
    place = folder.root / "sensor.toml"
    if tuple(card.channels) != sensor.channels:
        raise InputError(
            f"{place}: channels are {', '.join(sensor.channels)}, the bundle was made for "
            f"{', '.join(card.channels)}; train one on this sensor"
        )
    if card.base is not None and sensor.base is None:
        raise InputError(f"{place}: has no [base], which the bundle reads; train one on this sensor")
    card.at_rate(sensor.sample_rate_hz, f"{place}: sample_rate_hz")


def open_localizer(bundle: Path, rate_hz: float | None = None) -> Localizer:
    """One session a process, since opening it takes longer than a short recording. rate_hz: of the samples, None: as in
    the bundle's calibration, which one within 0.1 % is taken for."""
    card = bundle / "model.json"
    return _opened(bundle, rate_hz, card.stat().st_mtime_ns if card.is_file() else 0)


@lru_cache(maxsize=2)
def _opened(bundle: Path, rate_hz: float | None, written_ns: int) -> Localizer:
    """written_ns: when the card was; a bundle may be trained anew at the same place."""
    localizer = Localizer.load(bundle)
    close = rate_hz is None or math.isclose(localizer.card.sample_rate_hz, rate_hz, rel_tol=1e-3)
    return localizer if close or rate_hz is None else localizer.at_rate(rate_hz)

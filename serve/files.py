"""Recordings as a device reads them: volts with a clock that is checked."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softslide.features.card import Card
from softslide.features.clock import check_clock, own_rate_hz
from softslide.features.errors import InputError
from softslide.features.recording_file import read_samples
from softslide.features.units import impossible_output


def read_recording(path: Path, channels: Sequence[str], rate_hz: float) -> np.ndarray:
    """The volts (n, C) of one recording in float64, in the order of `channels`; its clock is checked.

    The file has a column `time_s` in s and one in V for each of `channels`; further columns are ignored.

    Raises:
        InputError: as `read_samples`, a gap in time, or another rate than `rate_hz`.
    """
    values = read_samples(path, ("time_s", *channels))
    check_clock(path, values[:, 0], rate_hz)
    return np.ascontiguousarray(values[:, 1:])


def read_for(path: Path, card: Card) -> tuple[np.ndarray, float]:
    """The volts (n, C) of one recording of a bundle's sensor, in the order of `Card.columns`, and their rate in Hz.

    Raises:
        InputError: as `read_recording`, a rate that is not read, or numbers that are volts of none of the
            accelerometers.
    """
    values = read_samples(path, ("time_s", *card.columns))
    rate_hz = own_rate_hz(values[:, 0], card.sample_rate_hz)
    check_clock(path, values[:, 0], rate_hz)
    card.at_rate(rate_hz, f"{path}: column time_s:")
    volts = np.ascontiguousarray(values[:, 1:])
    # Most of a recording is rest, or a slide of a few hundredths of a g.
    median = np.median(volts, axis=0)
    parts = card.sensor["accelerometers"]
    faults = [impossible_output(median[3 * n : 3 * n + 3], part) for n, part in enumerate(parts)]
    if all(faults):
        raise InputError(f"{path}: {parts[0]['name']}: {faults[0]}")
    return volts, rate_hz

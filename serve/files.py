"""Recordings as a device reads them: volts with a clock that is checked."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from features.clock import check_clock
from features.recording_file import finite, read_samples


def read_recording(path: Path, channels: Sequence[str], rate_hz: float) -> np.ndarray:
    """The volts (n, C) of one recording in float64, in the order of `channels`; its clock is checked.

    The file has a column `time_s` in s and one in V for each of `channels`; further columns are ignored.

    Raises:
        InputError: as `read_samples`, a gap in time, or another rate than `rate_hz`.
    """
    columns = ("time_s", *channels)
    return checked_volts(path, columns, read_samples(path, columns), rate_hz)


def checked_volts(
    place: Path | str, columns: Sequence[str], values: np.ndarray, rate_hz: float
) -> np.ndarray:
    """The volts (n, C) of a recording's table (n, 1 + C) with these columns, the first its time in s.

    place: opens an error's message.

    Raises:
        InputError: a cell that is no finite number, too few samples, a gap in time, or another rate than `rate_hz`.
    """
    check_clock(place, finite(place, columns, values)[:, 0], rate_hz)
    return np.ascontiguousarray(values[:, 1:])

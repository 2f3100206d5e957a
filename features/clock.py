"""The check of a recording's clock: even and at the sensor's rate, since every speed depends on it."""

from pathlib import Path

import numpy as np

from softslide.features.errors import InputError

# A crystal keeps time to 0.01 %. A clock off by 0.2 % shifts every speed by 0.2 %, as much as the best models err.
RATE_TOLERANCE = 0.002
# A rate is another one beyond this; within it, a clock is off.
ANOTHER = 0.02


def own_rate_hz(time_s: np.ndarray, rate_hz: float) -> float:
    """The rate of a recording's own clock, where it is another than the sensor's by more than ANOTHER; else `rate_hz`,
    which `check_clock` holds it to. time_s: (n,) s, n >= 2."""
    with np.errstate(over="ignore", invalid="ignore"):
        step, mean = float(np.median(np.diff(time_s))), float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if not (step > 0 and abs(mean / step - 1) < ANOTHER) or abs(step * rate_hz - 1) < ANOTHER:
        return rate_hz
    return 1 / mean


def check_clock(place: Path | str, time_s: np.ndarray, rate_hz: float) -> None:
    """Refuses a recording whose time does not increase evenly at the sensor's rate. time_s: (n,) s, n >= 2.

    place: opens an error's message.

    Raises:
        InputError: time that stands still or runs back, a gap, or another rate than `rate_hz`.
    """
    # Times beyond all bounds make a gap like others.
    with np.errstate(over="ignore"):
        steps = np.diff(time_s) * rate_hz
    if (bad := steps <= 0).any():
        row = int(bad.argmax())
        raise InputError(
            f"{place}: row {row + 2}, column time_s does not increase ({time_s[row]:.6f} then "
            f"{time_s[row + 1]:.6f} s); sort the samples and drop repeated ones"
        )
    typical = float(np.median(steps))
    if abs(typical - 1) < 0.25 and (bad := abs(steps - 1) > 0.5).any():
        row = int(bad.argmax())
        kind = "a gap" if steps[row] > 1 else "an uneven step"
        raise InputError(
            f"{place}: row {row + 2}, column time_s: {kind} of {time_s[row + 1] - time_s[row]:.6f} s where "
            f"samples are {1 / rate_hz:.6f} s apart; resample it with 'softslide import' or drop it"
        )
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    # Half a sample of jitter at either end changes this rate by 1 / steps.
    if abs(rate / rate_hz - 1) > RATE_TOLERANCE + 1 / len(steps):
        raise InputError(
            f"{place}: column time_s runs at {rate:.6g} Hz, sensor.toml says sample_rate_hz = {rate_hz:.6g}; "
            "correct the one that is wrong"
        )

"""Drift of the sensor, from the static output: at rest an accelerometer measures gravity, 1 g whatever its attitude.

The static output of each channel is followed and subtracted. From one static vector a shifted zero, a changed mounting
tilt and a changed gain cannot be distinguished. So gain and tilt are reported and not corrected: the models allow for a
change of gain, and a tilt of a few degrees hardly changes the response.

Sensing elements of another kind (`kind` in sensor.toml) do not measure gravity: of these the shift of the zero is read,
gain and tilt are not known.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Drift(NamedTuple):
    """Drift at one moment; NaN: not known.

    zero_shift_v: largest change of the static output of any channel that answers to a touch since the stream began, V;
    it is subtracted. gain: length of the static vector over the nominal one for 1 g. turn_deg: angle of the static
    vector to the accelerometer's z axis, deg. Both are means over the accelerometers in use.
    """

    zero_shift_v: float = math.nan
    gain: float = math.nan
    turn_deg: float = math.nan


UNKNOWN = Drift()


class DriftWatch:
    """Reads the drift of one stream's sensor.

    accelerometers: as in the card; those that measure gravity have zero_g_v in V and sensitivity_v_per_g in V/g.
    touch_axes, scale: of the volts that it is given, as in `Conditioning`; what it reads is in the sensor's own.
    complete: whether the first static output of every accelerometer has been noted.
    """

    def __init__(
        self, accelerometers: Sequence[Mapping[str, Any]], touch_axes: str = "xy", scale: float = 1.0
    ) -> None:
        self._scale, self._axes = scale, len(touch_axes)
        self._nominal = nominal_outputs(accelerometers, scale)
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self._first = np.full((len(self._nominal), 3), np.nan)
        self._awaited = np.ones(len(self._nominal), dtype=bool)
        self.complete = False

    def note(self, static_v: np.ndarray, known: np.ndarray) -> None:
        """Keeps the first static output, from (C,) V, of each accelerometer whose static output is known (A,)."""
        fresh = known & self._awaited
        if fresh.any():
            self._first[fresh] = static_v.reshape(-1, 3)[fresh]
            self._awaited = self._awaited & ~fresh
            self.complete = not self._awaited.any()

    def read(self, static_v: np.ndarray, usable: np.ndarray) -> Drift:
        """The drift now. static_v: (C,) V; usable: (A,), the accelerometers to read it from."""
        # For a few numbers, plain floats are several times faster than arrays.
        static, first = static_v.tolist(), self._first.ravel().tolist()
        shift, lengths, turns, upright = 0.0, 0.0, 0.0, 0
        known = [n for n in range(len(self._nominal)) if usable[n] and not self._awaited[n]]
        for n in known:
            shift = max(shift, *(abs(static[c] - first[c]) for c in range(3 * n, 3 * n + self._axes)))
            if (nominal := self._nominal[n]) is None:
                continue
            zero, sensitivity = nominal
            x, y, z = ((v - zero) / sensitivity for v in static[3 * n : 3 * n + 3])
            lengths += math.hypot(x, y, z)
            turns += math.degrees(math.atan2(math.hypot(x, y), z))
            upright += 1
        if not known:
            return UNKNOWN
        shift /= self._scale
        return Drift(shift, lengths / upright, turns / upright) if upright else Drift(shift)


def nominal_outputs(
    accelerometers: Sequence[Mapping[str, Any]], scale: float
) -> list[tuple[float, float] | None]:
    """Of each accelerometer of a card its output without acceleration, V, and what 1 g adds, both scaled; None for an
    element of another kind."""
    return [
        (scale * float(a["zero_g_v"]), scale * float(a["sensitivity_v_per_g"]))
        if measures_gravity(a)
        else None
        for a in accelerometers
    ]


def measures_gravity(element: Mapping[str, Any]) -> bool:
    """Whether a sensing element of the card is an accelerometer, as one without `kind` is."""
    return element.get("kind", "accelerometer") == "accelerometer"

"""What the static output tells about a device's drift: gravity is a vector of 1 g whatever the device does.

The zero of each channel is followed and taken off. One static vector cannot tell a channel's zero from the
device's turn, nor either from a change of gain along gravity; so gain and turn are reported, not taken off: a model
has a nuisance of its own for the gain, and a device that is turned by a few degrees tilts its boards alike.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Drift:
    """zero_shift_v: largest change of a V_x or V_y's static output since the stream began, V, taken off.

    gain: the static output's length over the data sheet's for 1 g; turn_deg: its angle to the accelerometer's z
    axis, deg; both the mean of the accelerometers in use. NaN: not known.
    """

    zero_shift_v: float = math.nan
    gain: float = math.nan
    turn_deg: float = math.nan


UNKNOWN = Drift()


class DriftWatch:
    """Follows one stream's static output.

    accelerometers: the card's, each with zero_g_v in V and sensitivity_v_per_g in V/g.
    """

    def __init__(self, accelerometers: Sequence[Mapping[str, Any]]) -> None:
        self._zero = np.array([a["zero_g_v"] for a in accelerometers], float)[:, None]
        self._sensitivity = np.array([a["sensitivity_v_per_g"] for a in accelerometers], float)[:, None]
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self._first = np.full((len(self._zero), 3), np.nan)
        self._awaited = np.ones(len(self._zero), dtype=bool)

    def note(self, static_v: np.ndarray, known: np.ndarray) -> None:
        """Keeps the first static output (C,) V of each accelerometer that is known (A,)."""
        fresh = known & self._awaited
        if fresh.any():
            self._first[fresh] = static_v.reshape(-1, 3)[fresh]
            self._awaited = self._awaited & ~fresh

    def read(self, static_v: np.ndarray, usable: np.ndarray) -> Drift:
        """static_v: (C,) V; usable: (A,), the accelerometers to read it from."""
        usable = usable & ~self._awaited
        if not usable.any():
            return UNKNOWN
        static = static_v.reshape(-1, 3)
        gravity = ((static - self._zero) / self._sensitivity)[usable]
        length = np.sqrt(np.square(gravity).sum(axis=1))
        across = np.hypot(gravity[:, 0], gravity[:, 1])
        return Drift(
            zero_shift_v=float(np.abs((static - self._first)[usable, :2]).max()),
            gain=float(length.mean()),
            turn_deg=float(np.degrees(np.arctan2(across, gravity[:, 2])).mean()),
        )

"""What the static output tells about a device's drift: gravity is a vector of 1 g whatever the device does.

The zero of each channel is followed and taken off. One static vector cannot tell a channel's zero from the
device's turn, nor either from a change of gain along gravity; so gain and turn are reported, not taken off: a model
has a nuisance of its own for the gain, and a device that is turned by a few degrees tilts its boards alike.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np


class Drift(NamedTuple):
    """zero_shift_v: largest change of a V_x or V_y's static output since the stream began, V, taken off.

    gain: the static output's length over the data sheet's for 1 g; turn_deg: its angle to the accelerometer's z
    axis, deg; both the mean of the accelerometers in use. NaN: not known.
    """

    zero_shift_v: float = math.nan
    gain: float = math.nan
    turn_deg: float = math.nan


UNKNOWN = Drift()
# By how much gravity may seem to change in a slide: what a robot's arm shakes a skin with, but no other thing's signal.
WEIGHT_G = 0.25


class DriftWatch:
    """Follows one stream's static output.

    accelerometers: the card's, each with zero_g_v in V and sensitivity_v_per_g in V/g.
    complete: whether each one's first static output has been noted.
    """

    def __init__(self, accelerometers: Sequence[Mapping[str, Any]]) -> None:
        self._boards = [(float(a["zero_g_v"]), float(a["sensitivity_v_per_g"])) for a in accelerometers]
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self._first = np.full((len(self._boards), 3), np.nan)
        self._awaited = np.ones(len(self._boards), dtype=bool)
        self.complete = False

    def note(self, static_v: np.ndarray, known: np.ndarray) -> None:
        """Keeps the first static output (C,) V of each accelerometer that is known (A,)."""
        fresh = known & self._awaited
        if fresh.any():
            self._first[fresh] = static_v.reshape(-1, 3)[fresh]
            self._awaited = self._awaited & ~fresh
            self.complete = not self._awaited.any()

    def weighs_the_same(self, static_v: np.ndarray, subtracted_v: np.ndarray, usable: np.ndarray) -> bool:
        """Whether gravity keeps its length while something slides, as it does on a skin that only tilts.

        static_v: (C,) V; subtracted_v: (C,) V, a slide's mean; usable: (A,), the accelerometers to ask.
        """
        static, during = static_v.tolist(), (static_v + subtracted_v).tolist()
        for n, (zero, sensitivity) in enumerate(self._boards):
            before_g, during_g = (
                math.dist(volts[3 * n : 3 * n + 3], (zero, zero, zero)) / sensitivity
                for volts in (static, during)
            )
            if usable[n] and abs(during_g - before_g) > WEIGHT_G:
                return False
        return True

    def read(self, static_v: np.ndarray, usable: np.ndarray) -> Drift:
        """static_v: (C,) V; usable: (A,), the accelerometers to read it from."""
        # A handful of numbers each 20 ms: plain floats are several times quicker than arrays.
        static, first = static_v.tolist(), self._first.ravel().tolist()
        shift, lengths, turns = 0.0, 0.0, 0.0
        known = [n for n in range(len(self._boards)) if usable[n] and not self._awaited[n]]
        for n in known:
            zero, sensitivity = self._boards[n]
            vx, vy, vz = static[3 * n : 3 * n + 3]
            x, y, z = ((v - zero) / sensitivity for v in (vx, vy, vz))
            shift = max(shift, abs(vx - first[3 * n]), abs(vy - first[3 * n + 1]))
            lengths += math.hypot(x, y, z)
            turns += math.degrees(math.atan2(math.hypot(x, y), z))
        return Drift(shift, lengths / len(known), turns / len(known)) if known else UNKNOWN

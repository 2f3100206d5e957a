"""Takes the robot's own motion out of a skin's signal: an accelerometer on what the skin is mounted on tells it.

A base that tilts or speeds up changes what every accelerometer of the skin measures, as a contact does. At rest on the
skin both measure the same acceleration a, each along axes of its own, so that the skin's output is linear in the
base's. A contact turns the board in the skin by small angles w about x and y: V_x changes by -S w_y a_z and V_y by
S w_x a_z, S the sensitivity. So what is left of both is divided by a_z, in what it was as the map was calibrated.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Of the gravity along an accelerometer's z axis as the map was calibrated: with less left, 60 degrees over, a contact
# turns the board half as visibly, and V_z answers too.
LEAST_SHARE = 0.5
BASE_COLUMNS = ("base_vx", "base_vy", "base_vz")


@dataclass(frozen=True)
class BaseMotion:
    """How a skin's outputs follow those of its base, A accelerometers with C = 3 A outputs.

    gains: (C, 3), V of the skin for each V of the base's V_x, V_y, V_z. base_v: (3,) V, static_v: (C,) V, what base and
    skin read untouched, in the attitude of the calibration. gravity_v: (A,) V, what gravity along z is of each
    accelerometer's V_z then; 0 of another sensing element, whose answer to a contact does not depend on gravity.

    Raises:
        ValueError: the sizes do not belong together.
    """

    gains: tuple[tuple[float, float, float], ...]
    base_v: tuple[float, float, float]
    static_v: tuple[float, ...]
    gravity_v: tuple[float, ...]

    def __post_init__(self) -> None:
        channels = len(self.gains)
        sizes = [len(row) for row in self.gains] + [len(self.base_v)]
        if set(sizes) != {3} or len(self.static_v) != channels or 3 * len(self.gravity_v) != channels:
            raise ValueError("base: gains, base_v, static_v and gravity_v are not of the same accelerometers")

    def without(self, volts: np.ndarray, base_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the skin would read in the attitude of the calibration: volts (..., C) V, base_v (..., 3) V -> the same.

        And where each accelerometer (..., A) is upright enough for that: gravity's share along z is LEAST_SHARE.
        """
        gains, base, static, along_z = self._arrays
        followed = (base_v - base) @ gains.T
        share = 1.0 + followed[..., 2::3] * along_z
        upright = share >= LEAST_SHARE
        scale = np.where(upright, share, 1.0)[..., None]
        left = volts - followed - static
        left = left.reshape(*left.shape[:-1], -1, 3)
        left = np.concatenate([left[..., :2] / scale, left[..., 2:]], axis=-1)
        return static + left.reshape(volts.shape), upright

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """gains (C, 3), base_v (3,), static_v (C,), and 1 over gravity_v (A,), 0 where there is none."""
        gravity = np.array(self.gravity_v)
        along_z = np.divide(1.0, gravity, out=np.zeros_like(gravity), where=gravity != 0.0)
        return np.array(self.gains), np.array(self.base_v), np.array(self.static_v), along_z

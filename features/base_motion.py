"""Takes the robot's own motion out of a skin's signal: an accelerometer on what the skin is mounted on tells it.

A base that tilts or speeds up changes what every accelerometer of the skin measures, as a contact does. Untouched, both
measure the same acceleration, each along axes of its own, so that the skin's output is linear in the base's. A contact
then turns the board by a vector w (rad) in the skin's plane, level in the attitude in which the map was calibrated,
and changes what is felt of an acceleration a by

    turned(w, a) = sin|w| / |w| w x a + (1 - cos|w|) / |w|^2 w x (w x a)

(O. Rodrigues, 1840). w follows from V_x and V_y; what it would make of gravity in that attitude takes the place of what
it made of a.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

# Of the gravity along an accelerometer's z axis as the map was calibrated: with less left, 60 degrees over, a contact
# turns the board half as visibly, and V_z answers too.
LEAST_SHARE = 0.5
# A contact that turns the board by 0.3 rad, on a base that leans over by 20 degrees, is found to 0.1 mV.
ITERATIONS = 4
# About x and y, rad: further the skin does not turn a board; what shows more is a knock, or no signal.
LARGEST_TURN = 0.5
BASE_COLUMNS = ("base_vx", "base_vy", "base_vz")


@dataclass(frozen=True)
class BaseMotion:
    """How a skin's outputs follow those of its base, A accelerometers with C = 3 A outputs.

    gains: (C, 3), V of the skin for each V of the base's V_x, V_y, V_z. base_v: (3,) V, static_v: (C,) V, what base and
    skin read untouched, in the attitude of the calibration. gravity_v: (C,) V, what gravity makes of static_v; 0 of
    another sensing element, whose answer to a contact does not depend on gravity.

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
        if set(sizes) != {3} or len(self.static_v) != channels or len(self.gravity_v) != channels:
            raise ValueError("base: gains, base_v, static_v and gravity_v are not of the same accelerometers")

    def without(self, volts: np.ndarray, base_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the skin would read in the attitude of the calibration: volts (..., C) V, base_v (..., 3) V -> the same.

        And where each accelerometer (..., A) is upright enough for that: gravity's share along z is LEAST_SHARE.
        """
        gains, base, static, gravity = self._arrays
        followed = _of_each((base_v - base) @ gains.T)
        felt = gravity + np.where(gravity.any(axis=-1, keepdims=True), followed, 0.0)
        upright = felt[..., 2] >= LEAST_SHARE * gravity[..., 2]
        left = _of_each(volts) - followed
        turn = _turn((left - static)[..., :2], np.where(upright[..., None], felt, gravity), gravity)
        left += _turned(turn, gravity) - _turned(turn, felt)
        return left.reshape(volts.shape), upright

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """gains (C, 3), base_v (3,), static_v (A, 3), gravity_v (A, 3)."""
        static, gravity = (_of_each(np.array(values)) for values in (self.static_v, self.gravity_v))
        return np.array(self.gains), np.array(self.base_v), static, gravity


def _of_each(volts: np.ndarray) -> np.ndarray:
    """(..., C) -> (..., A, 3)."""
    return volts.reshape(*volts.shape[:-1], -1, 3)


def _turn(changed: np.ndarray, felt: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """The turn (..., 3) rad about axes across `gravity` (A, 3) that changes V_x and V_y by `changed` (..., 2) V.

    felt: (..., 3) V, of which it does so; the turn is 0 where it is nothing along z. Found by iteration.
    """
    slant = gravity[..., :2] * _inverse(gravity[..., 2:])
    along_z = _inverse(felt[..., 2])
    x = y = z = np.zeros(along_z.shape)
    for _ in range(ITERATIONS):
        # w x a is (w_y a_z, -w_x a_z, ...)
        rest = changed - _turned(np.stack([x, y, z], axis=-1), felt)[..., :2]
        y = np.clip(y + rest[..., 0] * along_z, -LARGEST_TURN, LARGEST_TURN)
        x = np.clip(x - rest[..., 1] * along_z, -LARGEST_TURN, LARGEST_TURN)
        z = -(x * slant[..., 0] + y * slant[..., 1])
    return np.stack([x, y, z], axis=-1)


def _inverse(values: np.ndarray) -> np.ndarray:
    """1 / values, 0 where they are 0."""
    return np.divide(1.0, values, out=np.zeros(values.shape), where=values != 0.0)


def _turned(turn: np.ndarray, felt: np.ndarray) -> np.ndarray:
    """What a turn (..., 3) rad, below LARGEST_TURN, changes (..., 3) V by that is felt, to 1e-5 of it."""
    (x, y, z), (a, b, c) = np.moveaxis(turn, -1, 0), np.moveaxis(felt, -1, 0)
    along, size_2 = x * a + y * b + z * c, x * x + y * y + z * z
    # Series of sin(s) / s and (1 - cos(s)) / s^2.
    once, twice = 1.0 - size_2 / 6.0 * (1.0 - size_2 / 20.0), 0.5 - size_2 / 24.0 * (1.0 - size_2 / 30.0)
    changes = (
        once * (y * c - z * b) + twice * (x * along - size_2 * a),
        once * (z * a - x * c) + twice * (y * along - size_2 * b),
        once * (x * b - y * a) + twice * (z * along - size_2 * c),
    )
    return np.stack(changes, axis=-1)

"""Takes the robot's own motion out of a skin's signal: an accelerometer on what the skin is mounted on measures it.

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
# A step that changes no output by a tenth of a block's noise is the last one. A contact that turns the board by
# 0.3 rad, on a base that leans over by 20 degrees, takes four.
SMALLEST_STEP = 1e-4  # rad
ITERATIONS = 8
# About x and y, rad: further the skin does not turn a board; what shows more is a knock, or no signal.
LARGEST_TURN = 0.5
BASE = "base"
BASE_COLUMNS = tuple(f"{BASE}_v{axis}" for axis in "xyz")


@dataclass(frozen=True)
class BaseMotion:
    """How a skin's outputs follow those of its base, A accelerometers with C = 3 A outputs.

    gains: (C, 3), V of the skin for each V of the base's V_x, V_y, V_z. base_v: (3,) V, static_v: (C,) V, what base and
    skin read untouched, in the attitude of the calibration. gravity_v: (C,) V, what gravity makes of static_v; 0 of
    another sensing element, whose answer to a contact does not depend on gravity. `Card` checks the sizes.
    """

    gains: tuple[tuple[float, float, float], ...]
    base_v: tuple[float, float, float]
    static_v: tuple[float, ...]
    gravity_v: tuple[float, ...]

    def without(self, volts: np.ndarray, base_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the skin would read in the attitude of the calibration: volts (..., C) V, base_v (..., 3) V -> the same.

        And where each accelerometer (..., A) is upright enough for that: gravity's share along z is LEAST_SHARE.
        """
        gains, base, static, gravity, heavy = self._arrays
        followed = _axes((base_v - base) @ gains.T)
        felt = gravity + heavy * followed
        upright = felt[2] >= LEAST_SHARE * gravity[2]
        felt = np.where(upright, felt, gravity)
        left = _axes(volts) - followed
        turn = _turn(left[:2] - static[:2], felt, gravity)
        left += _turned(turn, gravity) - _turned(turn, felt)
        return left.transpose(1, 2, 0).reshape(volts.shape), upright.reshape(*volts.shape[:-1], -1)

    @cached_property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """gains (C, 3), base_v (3,), static_v and gravity_v (3, 1, A), and which have gravity (1, A)."""
        static, gravity = (_axes(np.array(values)) for values in (self.static_v, self.gravity_v))
        return np.array(self.gains), np.array(self.base_v), static, gravity, np.abs(gravity).sum(axis=0) > 0.0


def _axes(volts: np.ndarray) -> np.ndarray:
    """(..., C) -> (3, n, A): x, y and z of each accelerometer."""
    return volts.reshape(-1, volts.shape[-1] // 3, 3).transpose(2, 0, 1)


def _turn(changed: np.ndarray, felt: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """The turn (3, n, A) rad about axes across `gravity` (3, 1, A) that changes V_x and V_y by `changed` (2, n, A) V.

    felt: (3, n, A) V, of which it does so; the turn is 0 where it is nothing along z. Found by iteration.
    """
    slant = gravity[:2] * _inverse(gravity[2])
    along_z = _inverse(felt[2])
    turn = np.zeros(felt.shape)
    for _ in range(ITERATIONS):
        # w x a is (w_y a_z, -w_x a_z, ...)
        step = (changed - _turned(turn, felt)[:2]) * along_z
        turn[0] -= step[1]
        turn[1] += step[0]
        np.clip(turn, -LARGEST_TURN, LARGEST_TURN, out=turn)
        turn[2] = -(turn[0] * slant[0] + turn[1] * slant[1])
        if np.abs(step).max() < SMALLEST_STEP:
            break
    return turn


def _inverse(values: np.ndarray) -> np.ndarray:
    """1 / values, 0 where they are 0."""
    return np.divide(1.0, values, out=np.zeros(values.shape), where=values != 0.0)


def _turned(turn: np.ndarray, felt: np.ndarray) -> np.ndarray:
    """What a turn (3, n, A) rad, below LARGEST_TURN, changes (3, n, A) V by that is felt, to 1e-5 of it."""
    x, y, z = turn
    a, b, c = felt
    along, size_2 = x * a + y * b + z * c, x * x + y * y + z * z
    # Series of sin(s) / s and (1 - cos(s)) / s^2.
    once, twice = 1.0 - size_2 / 6.0 * (1.0 - size_2 / 20.0), 0.5 - size_2 / 24.0 * (1.0 - size_2 / 30.0)
    across = np.array([y * c - z * b, z * a - x * c, x * b - y * a])
    return once * across + twice * (turn * along - size_2 * felt)

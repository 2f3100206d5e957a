"""A path whose heading and logarithm of speed are cubic splines of time: it bends, changes speed, and never stops."""

from typing import NamedTuple

import numpy as np

LEAST_SPEED_MM_S = 1.0  # of a curve along places: logarithms need one


class Curve(NamedTuple):
    """A path of m blocks, at every half block.

    basis: (2 m + 1, n), splines of time; half_s: between two of its rows. start_mm: (2,), the first place. log_speed,
    heading: (n,), coefficients of the logarithm of the speed (mm/s) and of the heading (rad). gain: of the contact, 1
    is the calibration's.
    """

    basis: np.ndarray
    half_s: float
    start_mm: np.ndarray
    log_speed: np.ndarray
    heading: np.ndarray
    gain: float

    @property
    def parameters(self) -> np.ndarray:
        """(3 + 2 n,): start, gain, speed and heading."""
        return np.concatenate([self.start_mm, [self.gain], self.log_speed, self.heading])

    def changed(self, step: np.ndarray) -> "Curve":
        """By a step (3 + 2 n,) of the parameters."""
        n = len(self.heading)
        return self._replace(
            start_mm=self.start_mm + step[:2],
            gain=self.gain + float(step[2]),
            log_speed=self.log_speed + step[3 : 3 + n],
            heading=self.heading + step[3 + n :],
        )

    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """x, y (mm), vx, vy (mm/s) (2 m + 1, 4), and their derivatives (2 m + 1, 4, 3 + 2 n) by the parameters."""
        n = len(self.heading)
        speed, heading = np.exp(self.basis @ self.log_speed), self.basis @ self.heading
        velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
        across = np.stack([-velocity[:, 1], velocity[:, 0]], axis=1)
        by = np.zeros((len(self.basis), 4, 3 + 2 * n))
        by[:, 0, 0] = by[:, 1, 1] = 1.0
        by[:, 2:, 3 : 3 + n] = velocity[:, :, None] * self.basis[:, None]
        by[:, 2:, 3 + n :] = across[:, :, None] * self.basis[:, None]
        by[:, :2, 3:] = _integral(by[:, 2:, 3:], self.half_s)
        place = self.start_mm + _integral(velocity, self.half_s)
        return np.concatenate([place, velocity], axis=1), by


def curve_along(places: np.ndarray, block_s: float, averaged: float, knot_mm: float) -> Curve:
    """The curve along places (m, 2) mm, one at each block's middle.

    averaged: blocks, standard deviation of the weights by which a line is laid through the neighbours of each. knot_mm:
    way from one knot of the splines to the next.
    """
    count = len(places)
    apart = np.arange(count)[:, None] - np.arange(count)
    weight = np.exp(-0.5 * (apart / averaged) ** 2)
    zeroth, first, second = ((weight * apart**k).sum(1)[:, None] for k in range(3))
    middle = (second * (weight @ places) - first * ((weight * apart) @ places)) / (zeroth * second - first**2)
    velocity = np.gradient(middle, block_s, axis=0)
    speed = np.maximum(np.hypot(*velocity.T), LEAST_SPEED_MM_S)
    knots = min(max(round(float(speed.sum()) * block_s / knot_mm), 1), max(count // 3, 1))
    basis = spline_basis(np.linspace(0.0, 1.0, 2 * count + 1), knots)
    # A slight pull to even values, where fewer places than splines show one.
    even = 0.1 * np.diff(np.eye(basis.shape[1]), axis=0)
    shown = np.stack([np.log(speed), np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))], axis=1)
    known = np.concatenate([shown, np.zeros((len(even), 2))])
    log_speed, heading = np.linalg.lstsq(np.concatenate([basis[1::2], even]), known, rcond=None)[0].T
    curve = Curve(basis, block_s / 2, np.zeros(2), log_speed, heading, 1.0)
    return curve._replace(start_mm=(middle - curve.motion()[0][1::2, :2]).mean(axis=0))


def spline_basis(at: np.ndarray, intervals: int) -> np.ndarray:
    """Uniform cubic B-splines (de Boor, A Practical Guide to Splines, 1978, chapter IX) over [0, 1]: places (k,) ->
    (k, intervals + 3)."""
    cell = np.minimum((at * intervals).astype(int), intervals - 1)
    t = at * intervals - cell
    four = [(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]
    basis = np.zeros((len(at), intervals + 3))
    np.put_along_axis(basis, cell[:, None] + np.arange(4), np.stack(four, axis=1) / 6, axis=1)
    return basis


def _integral(values: np.ndarray, step_s: float) -> np.ndarray:
    """From the first row on, by the trapezoidal rule; the shape of the values."""
    between = 0.5 * step_s * (values[1:] + values[:-1])
    return np.concatenate([np.zeros_like(values[:1]), between.cumsum(axis=0)])

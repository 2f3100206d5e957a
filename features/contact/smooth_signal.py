"""The alternatives to a slide, by which a track's evidence is judged: signals that need no response map.

Two families, each of several strengths, in steady state, so that a step costs a few operations. In one each channel
follows an integrated random walk (level and slope) of its own: a smooth signal of no known origin. In the other a
single amplitude does, along a fixed direction of the channels: a press at one place, a tilt, a change of pressure, a
drift. What these predict as well as the response map does is no evidence of a slide.
"""

import math

import numpy as np

# V/s^1.5: rest, then from a contact of 0.3 mm/s to one of 15 mm/s over 25 mV/mm that change within 5 mm, and waves of
# 5 Hz, which no contact makes.
STRENGTHS = 1e-3 * np.array([0.02, 0.5, 2.0, 8.0, 32.0, 128.0, 512.0, 2048.0, 8192.0])
DOUBLINGS = 16  # of the Riccati recursion's steps; the slowest strength settles in 2500 of them
SWITCH = 0.01  # probability a step that the strength or the family changes
# Of the amplitude: how far a press leaves its direction while the object is pressed on (synthetic presses).
BENT = 0.03
# Outputs whose part across their common direction is less than this share (root mean square) have kept it.
STRAIGHT = 0.03
# A resting output is within this share of its mean over the last RESTING_S.
RESTING = 0.025
RESTING_S = 0.5


class SmoothSignal:
    """One stream. noise_v: (C,) V of one step's measurement; step_s: its length.

    changing_s: time for which the amplitude along the outputs' common direction has not rested. changed_s: the longest
    such time since the reset.
    """

    def __init__(self, noise_v: np.ndarray, step_s: float) -> None:
        self._noise, self._log_noise, self._step_s = noise_v, float(np.log(noise_v).sum()), step_s
        self._free = Walks(
            np.broadcast_to(STRENGTHS[:, None], (len(STRENGTHS), len(noise_v))), noise_v, step_s
        )
        # The amplitude's walks are of the outputs divided by their noise.
        each = STRENGTHS[:, None] / math.sqrt(float((noise_v**2).mean()))
        self._along = Walks(each, np.ones(1), step_s)
        self.reset(np.zeros(len(noise_v)), np.zeros(len(noise_v)))

    def reset(self, level_v: np.ndarray, slope_v_s: np.ndarray) -> None:
        """Starts from a level (C,) V and a slope (C,) V/s."""
        self._free.reset(level_v, slope_v_s)
        level = level_v / self._noise
        self._moment = np.outer(level, level)
        self._across_noise, self._lowest, self._highest = 1.0, 0.0, 0.0
        self._direction = level / max(float(np.hypot.reduce(level)), 1e-9)
        self._lately = float(level @ self._direction)
        self.changing_s = self.changed_s = 0.0
        self._along.reset(
            np.array([level @ self._direction]), np.array([slope_v_s / self._noise @ self._direction])
        )
        self._weight = np.full(2 * len(STRENGTHS), 0.5 / len(STRENGTHS))

    @property
    def one_way(self) -> bool:
        """Whether the outputs since the reset have kept one direction, as a press does; of two channels also one sign:
        with them a slide over the board may come back along the direction that it came on."""
        along = float(self._direction @ self._moment @ self._direction)
        across = float(self._moment.trace()) - along - self._across_noise * (len(self._noise) - 1)
        one_sign = len(self._noise) > 2 or self._lowest > -STRAIGHT * self._highest
        return across < STRAIGHT**2 * along and one_sign

    def push(self, volts: np.ndarray, vibration_v2: np.ndarray) -> float:
        """One measurement (C,) V -> the logarithm of its predicted density, less C/2 log(2 pi).

        vibration_v2: (C,) V^2, what the variance of its noise is larger by than noise_v says.
        """
        along = self._push_along(volts / self._noise, vibration_v2 / self._noise**2)
        log_density = np.concatenate([self._free.push(volts, vibration_v2), along])
        most = log_density.max()
        weight = self._weight * np.exp(log_density - most)
        total = weight.sum()
        self._weight = (1 - SWITCH) * weight / total + SWITCH / len(weight)
        self._free.join(self._weight[: len(STRENGTHS)])
        self._along.join(self._weight[len(STRENGTHS) :])
        level = float(self._along.mean(self._weight[len(STRENGTHS) :])[0][0])
        self._lately += min(self._step_s / RESTING_S, 1.0) * (level - self._lately)
        changing = abs(level - self._lately) > RESTING * abs(level)
        self.changing_s = self.changing_s + self._step_s if changing else 0.0
        self.changed_s = max(self.changed_s, self.changing_s)
        return float(most + np.log(total))

    def _push_along(self, whitened: np.ndarray, vibration: np.ndarray) -> np.ndarray:
        amplitude = float(whitened @ self._direction)
        self._lowest, self._highest = min(self._lowest, amplitude), max(self._highest, amplitude)
        noise = 1.0 + float(vibration.mean())
        self._across_noise += noise
        across = float(whitened @ whitened) - amplitude**2
        variance = noise + (BENT * amplitude) ** 2
        others = len(whitened) - 1
        along = np.array([self._direction**2 @ vibration])
        density = self._along.push(np.array([amplitude]), along) - 0.5 * (
            across / variance + others * math.log(variance)
        )
        self._moment += np.outer(whitened, whitened)
        # One step of the power method follows the direction of largest moment.
        turned = self._moment @ self._direction
        self._direction = turned / max(float(np.hypot.reduce(turned)), 1e-9)
        return density - self._log_noise


class Walks:
    """Kalman filters of integrated random walks, in steady state. strengths: (S, C) V/s^1.5; noise_v: (C,) V."""

    def __init__(self, strengths: np.ndarray, noise_v: np.ndarray, step_s: float) -> None:
        self._step_s = step_s
        noise = np.broadcast_to(noise_v**2, strengths.shape)
        ahead = _settled(strengths, noise, step_s)
        spread = ahead[..., 0, 0] + noise
        gain = ahead[..., 0, 0] / spread, ahead[..., 0, 1] / spread
        self._level_gain, self._slope_gain, self._spread = *gain, spread

    def reset(self, level: np.ndarray, slope: np.ndarray) -> None:
        """Starts all walks from a level and a slope (C,)."""
        self._level = np.tile(level, (len(self._spread), 1))
        self._slope = np.tile(slope, (len(self._spread), 1))

    def join(self, weight: np.ndarray) -> None:
        """Sets the level and slope of walks of low weight to the weighted mean. weight: (S,)."""
        lost = weight < 2 * SWITCH * weight.sum()
        self._level[lost], self._slope[lost] = self.mean(weight)
        if lost[0]:
            self._slope[0] = 0.0  # a press or a tilt may end at once

    def mean(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The weighted mean of the levels (C,) and of the slopes (C,). weight: (S,)."""
        weight = weight / weight.sum()
        return weight @ self._level, weight @ self._slope

    def push(self, measured: np.ndarray, vibration_v2: np.ndarray) -> np.ndarray:
        """One measurement (C,) -> (S,), the logarithms of its predicted densities, less C/2 log(2 pi).

        vibration_v2: (C,) V^2, what the variance of its noise is larger by; the filters' gains stay those without it.
        """
        self._level += self._step_s * self._slope
        gap = measured - self._level
        self._level += self._level_gain * gap
        self._slope += self._slope_gain * gap
        spread = self._spread + vibration_v2
        return -0.5 * (gap**2 / spread + np.log(spread)).sum(1)


def _settled(strengths: np.ndarray, noise: np.ndarray, step_s: float) -> np.ndarray:
    """Predicted covariances (S, C, 2, 2) of level and slope in steady state, by the structure-preserving doubling of
    the Riccati equation (Chu, Fan, Lin and Wang, Int. J. Control 77, 2004). noise: (S, C) V^2."""
    drive = np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    ahead = strengths[..., None, None] ** 2 * drive
    onward = np.broadcast_to(np.array([[1.0, 0.0], [step_s, 1.0]]), ahead.shape)
    known = np.zeros(ahead.shape)
    known[..., 0, 0] = 1.0 / noise
    for _ in range(DOUBLINGS):
        mixed = np.linalg.inv(np.eye(2) + known @ ahead)
        back = onward.swapaxes(-1, -2)
        known, ahead, onward = (
            known + onward @ mixed @ known @ back,
            ahead + back @ ahead @ mixed @ onward,
            onward @ mixed @ onward,
        )
    return ahead

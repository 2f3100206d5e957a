"""The alternative to a contact: a smooth signal of no known origin, by which a track's evidence is judged.

Each channel follows an integrated random walk (level and slope) of one of several strengths, in steady state, so that
a step costs a few operations. What such a model predicts as well as the response map does is no evidence of a contact.
"""

import numpy as np

# V/s^1.5: from a contact of 0.3 mm/s to one of 15 mm/s over 25 mV/mm that change within 5 mm.
STRENGTHS = 1e-3 * np.array([0.5, 2.0, 8.0, 32.0, 128.0, 512.0])
SETTLED = 400  # steps of the Riccati recursion; the slowest strength settles in 300
SWITCH = 0.01  # probability a step that the strength changes


class SmoothSignal:
    """One stream. noise_v: (C,) V of one step's measurement; step_s: its length."""

    def __init__(self, noise_v: np.ndarray, step_s: float) -> None:
        self._step_s = step_s
        shape = (len(STRENGTHS), len(noise_v))
        drive = np.broadcast_to(STRENGTHS[:, None] ** 2, shape)
        noise = np.broadcast_to(noise_v**2, shape)
        level, both, slope = noise * 10.0, np.zeros(shape), np.full(shape, 0.01)
        for _ in range(SETTLED):
            ahead = level + 2 * step_s * both + step_s**2 * slope + drive * step_s**3 / 3
            mixed = both + step_s * slope + drive * step_s**2 / 2
            slope = slope + drive * step_s
            spread = ahead + noise
            level, both, slope = ahead * noise / spread, mixed * noise / spread, slope - mixed**2 / spread
            gain = ahead / spread, mixed / spread
        self._level_gain, self._slope_gain, self._spread = *gain, spread
        self._log_spread = np.log(spread).sum(1)
        self.reset(np.zeros(len(noise_v)), np.zeros(len(noise_v)))

    def reset(self, level_v: np.ndarray, slope_v_s: np.ndarray) -> None:
        """Starts from a level (C,) V and a slope (C,) V/s."""
        self._level = np.tile(level_v, (len(STRENGTHS), 1))
        self._slope = np.tile(slope_v_s, (len(STRENGTHS), 1))
        self._weight = np.full(len(STRENGTHS), 1.0 / len(STRENGTHS))

    def push(self, volts: np.ndarray) -> float:
        """One measurement (C,) V -> the logarithm of its predicted density, less C/2 log(2 pi)."""
        self._level += self._step_s * self._slope
        gap = volts - self._level
        log_density = -0.5 * ((gap**2 / self._spread).sum(1) + self._log_spread)
        most = log_density.max()
        weight = self._weight * np.exp(log_density - most)
        total = weight.sum()
        self._weight = (1 - SWITCH) * weight / total + SWITCH / len(weight)
        self._level += self._level_gain * gap
        self._slope += self._slope_gain * gap
        return float(most + np.log(total))

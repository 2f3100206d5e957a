"""The stage: how far along its line an indenter is, at any time, with ramps, a stop or a way back."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Stroke:
    """One stroke and, if `back_mm` is not 0, a second one back along the line after `dwell_s` at the turn.

    ramp_s: time to reach the speed, and to stop, at constant acceleration.
    """

    travel_mm: float
    speed_mm_s: float
    ramp_s: float
    back_mm: float = 0.0
    dwell_s: float = 0.0

    @property
    def forth_s(self) -> float:
        """How long the first stroke takes, ramps included."""
        return self.travel_mm / self.speed_mm_s + self.ramp_s

    @property
    def duration_s(self) -> float:
        """How long all motion takes."""
        if not self.back_mm:
            return self.forth_s
        return self.forth_s + self.dwell_s + self.back_mm / self.speed_mm_s + self.ramp_s

    def forth(self, since_s: np.ndarray) -> np.ndarray:
        """Way done in the first stroke, mm, at (n,) s since the motion began."""
        return _trapezoid(since_s, self.travel_mm, self.speed_mm_s, self.ramp_s)

    def back(self, since_s: np.ndarray) -> np.ndarray:
        """Way done back, mm; the indenter is at `forth` less `back`."""
        if not self.back_mm:
            return np.zeros(np.shape(since_s))
        return _trapezoid(since_s - self.forth_s - self.dwell_s, self.back_mm, self.speed_mm_s, self.ramp_s)

    def speed(self, since_s: np.ndarray) -> np.ndarray:
        """How fast the indenter moves either way, mm/s."""
        to_stop = np.minimum(since_s, self.forth_s - since_s)
        if self.back_mm:
            left = since_s - self.forth_s - self.dwell_s
            to_stop = np.maximum(to_stop, np.minimum(left, self.duration_s - since_s))
        return self.speed_mm_s * np.clip(to_stop / max(self.ramp_s, 1e-9), 0, 1)


def _trapezoid(since_s: np.ndarray, travel: float, speed: float, ramp_s: float) -> np.ndarray:
    """Way (n,) mm: speed rises over the ramp, holds, falls over the ramp.

    The integral of a trapezoid is a difference of two ramped steps, r(t) = t^2 / (2 ramp) up to the ramp's end and
    t - ramp / 2 from there.
    """

    def ramped(t: np.ndarray) -> np.ndarray:
        inside = np.clip(t, 0, ramp_s)
        return inside**2 / (2 * max(ramp_s, 1e-9)) + np.maximum(t - ramp_s, 0)

    return speed * (ramped(since_s) - ramped(since_s - travel / speed))

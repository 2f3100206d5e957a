"""The stage: how far along its line an indenter is, at any time, with ramps, a stop or a way back."""

from dataclasses import dataclass

import numpy as np

from softslide.pipeline.recordings.stroke import stage_motion


@dataclass(frozen=True)
class Stroke:
    """One stroke and, if `back_mm` is not 0, a second one back along the line after a rest of `dwell_s`.

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

    def at(self, since_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """At (n,) s since the motion began: mm travelled in the first stroke and back in the second, whose difference
        is where the indenter is; and how fast it moves either way, mm/s."""
        forth, speed = stage_motion(since_s, self.travel_mm, self.speed_mm_s, self.forth_s)
        if not self.back_mm:
            return forth, np.zeros(np.shape(since_s)), speed
        begin_s = self.forth_s + self.dwell_s
        again = stage_motion(since_s - begin_s, self.back_mm, self.speed_mm_s, self.duration_s - begin_s)
        return forth, again[0], np.maximum(speed, again[1])

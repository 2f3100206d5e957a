"""Where a path leads, whatever its speed: headings and depths at even steps of the way."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

# Way between two knots: a circle of 8 mm turns by less than 0.1 degrees from one to the next.
STEP_MM = 0.01


@dataclass(frozen=True)
class Course:
    """Where a path leads, whatever the speed: headings (n,) rad of n even steps of STEP_MM, and n + 1 depths mm."""

    start_mm: tuple[float, float]
    heading_rad: np.ndarray
    depth_mm: np.ndarray

    @property
    def travel_mm(self) -> float:
        """The whole way."""
        return STEP_MM * len(self.heading_rad)

    @property
    def way_mm(self) -> np.ndarray:
        """(n + 1,) mm done at each knot."""
        return STEP_MM * np.arange(len(self.heading_rad) + 1)

    @property
    def _along(self) -> np.ndarray:
        return np.column_stack([np.cos(self.heading_rad), np.sin(self.heading_rad)])

    def places(self) -> np.ndarray:
        """(n + 1, 2) mm of the indenter's centre at each knot."""
        way = np.cumsum(STEP_MM * self._along, axis=0)
        return np.array(self.start_mm) + np.concatenate([np.zeros((1, 2)), way])

    def friction(self, friction_mm: float) -> np.ndarray:
        """(n + 1, 2) the friction's direction, of length 1 where it is fully there and 0 before any way.

        It follows the motion within some way, dp/ds = (t - p) / friction_mm with the motion's direction t (P. R.
        Dahl, 1968); where nothing moves it stays.
        """
        if not len(self.heading_rad):
            return np.zeros((1, 2))
        forget = np.exp(-STEP_MM / max(friction_mm, 1e-9))
        followed = lfilter([1 - forget], [1, -forget], self._along, axis=0)
        return np.concatenate([np.zeros((1, 2)), followed])

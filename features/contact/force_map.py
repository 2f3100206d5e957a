"""What the model card carries for forces: the solved skin's force on an object, times what a scale said of it."""

from dataclasses import dataclass

import numpy as np

from softslide.features.contact.calibration import check_map
from softslide.features.contact.packed import packed, unpacked
from softslide.features.contact.response_surface import PARTS, ResponseSurface

AXES = 3  # along x, along y, normal
# Of the largest coefficient of a part and axis, in steps. Eight bits are within 0.1 % of sixteen, coarser knots are not
# (experiments/LOG.md).
MOST_STEPS = 127


@dataclass(frozen=True)
class ForceMap:
    """The card's section `force`: the skin's force on the object, in mN.

    F(x, y, a, d) = M + cos(a) Fx + sin(a) Fy + (d - d0) D along x, along y and normal to the skin, like the response
    map. coefficients: int8, `packed`, (4, K, K, 3), the splines of M, Fx, Fy and D in steps. steps_mn: the size of a
    step (mN; of D mN/mm) of each of the 4 x 3 parts and axes. knots: K. half_mm: the splines cover [-half_mm, half_mm].
    spacing_mm: of the knots. depth_mm: d0. relative_sd: standard deviation of the map's common factor. scale_readings:
    how many readings it rests on.

    Raises:
        ValueError: a number is out of range, or the coefficients are not as many as K says.
    """

    coefficients: str
    steps_mn: tuple[float, ...]
    knots: int
    half_mm: float
    spacing_mm: float
    depth_mm: float
    relative_sd: float
    scale_readings: int = 0

    def __post_init__(self) -> None:
        numbers = (*self.steps_mn, self.half_mm, self.spacing_mm, self.depth_mm, self.relative_sd)
        check_map("force", numbers, self.knots, self.coefficients)
        if type(self.scale_readings) is not int or self.scale_readings < 0:
            raise ValueError(f"force: scale_readings {self.scale_readings!r:.40} is no number of readings")
        self.surface()

    def surface(self) -> ResponseSurface:
        """The map, ready to be read: mN and mN/mm."""
        shape = (PARTS, self.knots, self.knots, AXES)
        stored = unpacked(self.coefficients, np.int8, shape)
        steps_mn = np.array(self.steps_mn).reshape(PARTS, 1, 1, AXES)
        return ResponseSurface(stored * steps_mn, self.half_mm, self.spacing_mm)


def in_steps(splines: np.ndarray) -> tuple[str, tuple[float, ...]]:
    """Splines (4, K, K, 3) in mN and mN/mm -> the card's `coefficients` and `steps_mn`."""
    largest = np.abs(splines).max(axis=(1, 2), keepdims=True)
    steps_mn = np.where(largest > 0, largest, 1.0) / MOST_STEPS
    stored = np.round(splines / steps_mn).astype(np.int8)
    return packed(stored), tuple(steps_mn.ravel().tolist())


def weights(direction_rad: np.ndarray | None, off_mm: np.ndarray | float, count: int) -> np.ndarray:
    """(N, 4) of M, Fx, Fy, D. direction_rad: (N,), None without sliding. off_mm: depth less the map's."""
    each = np.zeros((count, PARTS))
    each[:, 0], each[:, 3] = 1.0, off_mm
    if direction_rad is not None:
        each[:, 1], each[:, 2] = np.cos(direction_rad), np.sin(direction_rad)
    return each

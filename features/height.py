"""What the model card carries for the skin's height: the response map's change with it.

An inflated skin that stands higher answers otherwise. What its accelerometers read at rest shows the height that is in
use (`rest_height.py`).
"""

import math
from dataclasses import dataclass

import numpy as np

from softslide.features.contact.calibration import check_map, decoded
from softslide.features.errors import InputError

# A graph's input that need not be given: the skin's height less height_mm, mm.
HEIGHT_INPUT = "height_off_mm"
MARGIN_MM = 0.1  # beyond the calibration's heights: what a laser may err by


@dataclass(frozen=True)
class HeightCalibration:
    """The card's section `heights`.

    coefficients: float16, little-endian, `packed`, (K, K, C) in units of scale_v: the splines of H (V/mm), which the
    response map's M changes by. knots: K. height_mm: h0, the height that map and graph are of unless another is given.
    lowest_mm, highest_mm: of the calibration's.

    Raises:
        ValueError: a number is out of range.
    """

    coefficients: str
    scale_v: float
    knots: int
    height_mm: float
    lowest_mm: float
    highest_mm: float

    def __post_init__(self) -> None:
        numbers = (self.scale_v, self.height_mm, self.lowest_mm, self.highest_mm)
        check_map("heights", numbers, self.knots, self.coefficients)
        if not self.lowest_mm < self.highest_mm:
            raise ValueError(f"heights: {self.lowest_mm:g} to {self.highest_mm:g} mm do not rise")
        if not self.lowest_mm <= self.height_mm <= self.highest_mm:
            raise ValueError(f"heights: height_mm {self.height_mm:g} is not among them")

    @property
    def range_off_mm(self) -> tuple[float, float]:
        """The calibration's least and largest height, less height_mm."""
        return self.lowest_mm - self.height_mm, self.highest_mm - self.height_mm

    def splines(self, channels: int) -> np.ndarray:
        """(K, K, C) V/mm: the splines of H, of so many channels.

        Raises:
            ValueError: the coefficients are not as many as K and C say.
        """
        return decoded(self.coefficients, (self.knots, self.knots, channels), self.scale_v)


def given_height(heights: HeightCalibration | None, height_mm: float | None) -> float:
    """The height that a user gives in mm, NaN if none.

    Raises:
        InputError: the bundle is for one height, or not for this one.
    """
    if height_mm is None:
        return math.nan
    if heights is None:
        raise InputError(
            "has no effect: the bundle is for one height of the skin; leave it out, or train one at several",
            "height",
        )
    low, high = heights.lowest_mm, heights.highest_mm
    if not low - MARGIN_MM <= height_mm <= high + MARGIN_MM:
        raise InputError(f"{height_mm:g} mm: the bundle is for {low:.2f} to {high:.2f} mm", "height")
    return height_mm

"""What the model card carries for the skin's height: the response map's change with it, and the static output's.

An inflated skin that stands higher answers otherwise, and tilts its accelerometers otherwise at rest. So the static
output shows the height that is in use, as long as the sensor is mounted as it was in the calibration.
"""

import math
from dataclasses import dataclass

import numpy as np

from softslide.features.contact.calibration import LARGEST, check_map, decoded
from softslide.features.errors import InputError

# A graph's input that need not be given: the skin's height less height_mm, mm.
HEIGHT_INPUT = "height_off_mm"
# Standard deviations beyond which a static output is not one of the calibration's mounting.
MOUNTED_SD = 5.0
# Largest standard deviation of a height from the static output, as a share of the range of heights.
TELLING_SHARE = 0.25
# What a height beyond the calibration's is off by at least before it counts: the response changes by 9 % a mm on
# `bench-depth`, and by 2 % (`gain_sd` of `bench-a`) from slide to slide anyway.
LEAST_OFF_MM = 0.2
MARGIN_MM = 0.1  # beyond the calibration's heights: what a laser may err by


@dataclass(frozen=True)
class HeightCalibration:
    """The card's section `heights`.

    coefficients: float16, little-endian, `packed`, (K, K, C) in units of scale_v: the splines of H (V/mm), which the
    response map's M changes by. knots: K. height_mm: h0, the height that map and graph are of unless another is given.
    lowest_mm, highest_mm: of the calibration's. static_v, static_v_per_mm, static_sd_v: (C,), the output at rest at h0,
    its change with height (V/mm), and its standard deviation about both.

    Raises:
        ValueError: a number is out of range, or the coefficients are not as many as K and C say.
    """

    coefficients: str
    scale_v: float
    knots: int
    height_mm: float
    lowest_mm: float
    highest_mm: float
    static_v: tuple[float, ...]
    static_v_per_mm: tuple[float, ...]
    static_sd_v: tuple[float, ...]

    def __post_init__(self) -> None:
        numbers = (self.scale_v, self.height_mm, self.lowest_mm, self.highest_mm, *self.static_sd_v)
        check_map("heights", numbers, self.knots, self.coefficients)
        if not self.lowest_mm < self.highest_mm:
            raise ValueError(f"heights: {self.lowest_mm:g} to {self.highest_mm:g} mm do not rise")
        if not self.lowest_mm <= self.height_mm <= self.highest_mm:
            raise ValueError(f"heights: height_mm {self.height_mm:g} is not among them")
        static = np.array([self.static_v, self.static_v_per_mm, self.static_sd_v], dtype=float)
        if not (np.abs(static) <= LARGEST).all():
            raise ValueError(f"heights: a static output is not finite or beyond {LARGEST:g}")
        self.splines()

    @property
    def range_off_mm(self) -> tuple[float, float]:
        """The calibration's least and largest height, less height_mm."""
        return self.lowest_mm - self.height_mm, self.highest_mm - self.height_mm

    def splines(self) -> np.ndarray:
        """(K, K, C) V/mm: the splines of H."""
        return decoded(self.coefficients, (self.knots, self.knots, len(self.static_v)), self.scale_v)

    def estimate(self, static_v: np.ndarray) -> float:
        """The height in mm from a static output (C,) V, within the calibration's range; NaN where it shows none:
        another mounting, or a skin outside the range."""
        weight = 1.0 / np.square(self.static_sd_v)
        slope = np.array(self.static_v_per_mm)
        off_v = np.asarray(static_v) - self.static_v
        information = float(weight @ slope**2)
        sd_mm = information**-0.5 if information > 0 else math.inf
        if not sd_mm < TELLING_SHARE * (self.highest_mm - self.lowest_mm):
            return math.nan
        off_mm = float((weight * slope) @ off_v) / information
        off_line = np.abs(off_v - off_mm * slope) / self.static_sd_v
        height_mm = self.height_mm + off_mm
        margin_mm = max(LEAST_OFF_MM, MOUNTED_SD * sd_mm)
        inside = self.lowest_mm - margin_mm <= height_mm <= self.highest_mm + margin_mm
        if not (inside and off_line.max() < MOUNTED_SD):
            return math.nan
        return min(max(height_mm, self.lowest_mm), self.highest_mm)


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

"""The skin's height, and so whether another pressure is below it, from the static output of its accelerometers.

The boards of a skin that stands higher lean over further. Other things change the static output too: it scatters from
slide to slide; the gain changes, of all outputs alike; device or mounting tilt, all boards alike. Generalized least
squares (A. C. Aitken, 1936) find the height next to these. With one accelerometer a tilt may look like a height, so
that a mounting is taken to stay as it was in the calibration, unless the static output scatters like a tilt there.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softslide.features.contact.calibration import ContactCalibration
from softslide.features.height import HeightCalibration
from softslide.features.stream.drift import nominal_outputs

# Standard deviations beyond which a static output is not one of the calibration's mounting.
MOUNTED_SD = 5.0
# Largest standard deviation of a height from the static output, as a share of the range of heights.
TELLING_SHARE = 0.25
# What a height beyond the calibration's is off by at least before it counts: the response changes by 9 % a mm on
# `bench-depth`, and by 2 % (`gain_sd` of `bench-a`) from slide to slide anyway.
LEAST_OFF_MM = 0.2
# Priors so wide that the static output decides: the data sheet's tolerance of the gain is 7.5 %; six degrees.
GAIN_SD = 0.1
TILT_SD_RAD = 0.1
LEAST = 1e-12  # above zero


class RestHeight:
    """Judges static outputs (3 A,) V of one bundle, its calibration of contacts with a static output.

    heights: of a bundle over heights; None: it is for one. accelerometers, scale: as for `DriftWatch`.
    """

    def __init__(
        self,
        contact: ContactCalibration,
        heights: HeightCalibration | None,
        accelerometers: Sequence[Mapping[str, Any]],
        scale: float,
    ) -> None:
        boards = len(accelerometers)
        self._heights = heights
        self._static = np.array(contact.static_v)
        # Of an element that does not measure gravity neither gain nor tilt is known to change the static output.
        gravity = np.zeros((boards, 3))
        for n, nominal in enumerate(nominal_outputs(accelerometers, scale)):
            if nominal is not None:
                gravity[n] = self._static[3 * n : 3 * n + 3] - nominal[0]
        change = np.zeros((boards, 3))
        inflation = np.reshape(contact.inflation_v_per_mm, (boards, -1))
        change[:, : inflation.shape[1]] = inflation
        # Gravity keeps its length.
        square = np.maximum((gravity**2).sum(axis=1), LEAST)
        change -= gravity * ((gravity * change).sum(axis=1) / square)[:, None]
        covariance = np.array(contact.static_covariance_v2)
        others = [GAIN_SD * gravity]
        if boards > 1:
            others += [TILT_SD_RAD * np.cross(axis, gravity) for axis in np.eye(3)[:2]]
        for other in others:
            covariance = covariance + np.outer(other, other)
        self._inverse = np.linalg.inv(covariance)
        self._weight = self._inverse @ change.ravel()
        self._information = max(float(self._weight @ change.ravel()), LEAST)
        self._off_line = MOUNTED_SD**2 * boards
        margin_mm = max(LEAST_OFF_MM, MOUNTED_SD * self.sd_mm)
        low, high = (0.0, 0.0) if heights is None else heights.range_off_mm
        self._range_mm = low - margin_mm, high + margin_mm
        # Whether the static output shows which of the bundle's heights the skin has.
        self.shows = self.sd_mm < TELLING_SHARE * (high - low)

    @property
    def sd_mm(self) -> float:
        """Standard deviation of a height."""
        return self._information**-0.5

    def off_mm(self, static_v: np.ndarray) -> float:
        """The skin's height less the calibration's; NaN where no height explains the static output: the sensor is
        mounted otherwise, or its zeros have drifted."""
        off_v = static_v - self._static
        off_mm = float(self._weight @ off_v) / self._information
        off_line = float(off_v @ self._inverse @ off_v) - off_mm**2 * self._information
        return off_mm if off_line <= self._off_line else np.nan

    def height_mm(self, static_v: np.ndarray) -> float:
        """The skin's height, within the calibration's; NaN where the static output shows none, or another."""
        if self._heights is None or not self.shows:
            return math.nan
        off_mm = self.off_mm(static_v)
        if not self._range_mm[0] <= off_mm <= self._range_mm[1]:  # so where it is NaN
            return math.nan
        low, high = self._heights.range_off_mm
        return self._heights.height_mm + min(max(off_mm, low), high)

    def is_other(self, static_v: np.ndarray) -> bool:
        """Whether the skin's height is one that the bundle is not for."""
        off_mm = self.off_mm(static_v)
        return off_mm < self._range_mm[0] or off_mm > self._range_mm[1]


def rest_height(
    contact: ContactCalibration | None,
    heights: HeightCalibration | None,
    accelerometers: Sequence[Mapping[str, Any]],
    scale: float,
) -> RestHeight | None:
    """`RestHeight` of a card; None where it does not know the static output, or how that changes with height."""
    if contact is None or not contact.static_v or not any(contact.inflation_v_per_mm):
        return None
    return RestHeight(contact, heights, accelerometers, scale)

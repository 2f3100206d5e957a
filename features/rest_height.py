"""Whether the static output shows a skin at another height than the calibration's: another pressure below it.

The boards of a skin that stands higher lean over further. Other things change the static output too: it scatters from
slide to slide; the gain changes, of all outputs alike; device or mounting tilt, all boards alike. Generalized least
squares (A. C. Aitken, 1936) find the height next to these. With one accelerometer a tilt may look like a height, so
that a mounting is taken to stay as it was in the calibration, unless the static output scatters like a tilt there.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from softslide.features.contact.calibration import ContactCalibration
from softslide.features.height import LEAST_OFF_MM, MOUNTED_SD, HeightCalibration
from softslide.features.stream.drift import nominal_outputs

# Priors so wide that the static output decides: the data sheet's tolerance of the gain is 7.5 %; six degrees.
GAIN_SD = 0.1
TILT_SD_RAD = 0.1


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
        self._static = np.array(contact.static_v)
        zero = np.repeat([pair[0] for pair in nominal_outputs(accelerometers, scale) if pair], 3)
        gravity = (self._static - zero).reshape(boards, 3)
        change = np.zeros((boards, 3))
        change[:, :2] = np.reshape(contact.inflation_v_per_mm, (boards, 2))
        # Gravity keeps its length.
        change -= gravity * ((gravity * change).sum(axis=1) / (gravity**2).sum(axis=1))[:, None]
        covariance = np.array(contact.static_covariance_v2)
        others = [GAIN_SD * gravity]
        if boards > 1:
            others += [TILT_SD_RAD * np.cross(axis, gravity) for axis in np.eye(3)[:2]]
        for other in others:
            covariance = covariance + np.outer(other, other)
        self._inverse = np.linalg.inv(covariance)
        self._weight = self._inverse @ change.ravel()
        self._information = float(self._weight @ change.ravel())
        self._off_line = MOUNTED_SD**2 * boards
        margin_mm = max(LEAST_OFF_MM, MOUNTED_SD * self.sd_mm)
        low, high = (0.0, 0.0) if heights is None else heights.range_off_mm
        self._range_mm = low - margin_mm, high + margin_mm

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

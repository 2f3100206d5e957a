"""The calibrated response map as the model card's section `contact`."""

import numpy as np

from features.contact.calibration import ContactCalibration, encoded
from models.response_map.map import ResponseMap


def contact_calibration(response: ResponseMap) -> ContactCalibration:
    """What a device needs of the map to track contacts."""
    assert response.noise_v is not None
    text, scale = encoded(np.concatenate([response.coefficients, response.depth_slope[None]]))
    return ContactCalibration(
        coefficients=text,
        scale_v=scale,
        knots=response.coefficients.shape[1],
        half_mm=response.half_mm,
        spacing_mm=response.spacing_mm,
        chamber_mm=response.chamber_mm,
        depth_mm=response.depth_mm,
        noise_v=tuple(float(v) for v in response.noise_v),
        floor_v=float(response.floor_v),
        gain_sd=float(response.gain_sd),
        depth_sd_mm=response.depth_sd_mm or ContactCalibration.depth_sd_mm,
    )

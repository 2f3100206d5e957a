"""One slide beside a map: its own gain, its shift along its line, and what the map leaves of it."""

from dataclasses import dataclass

import numpy as np

from models.response_map.config import CalibrationConfig
from models.response_map.map import ResponseMap
from models.response_map.slides import CalibrationSlide

# So much of a stretch's output is never explained: one step of the article's converter.
LEAST_RESIDUAL_V = 5e-4
SHIFT_STEP_MM = 0.05  # of the central difference
ITERATIONS = 2  # Gauss-Newton of two numbers that start within a few percent


@dataclass(frozen=True)
class SlideFit:
    """A slide's own gain and shift along its line, and the residual (m, C) V beside the map."""

    gain: float
    shift_mm: float
    residual_v: np.ndarray

    @property
    def rms_v(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual_v**2)))


def fit_slide(
    slide: CalibrationSlide,
    response: ResponseMap,
    config: CalibrationConfig,
    gain: float = 1.0,
    shift_mm: float = 0.0,
) -> SlideFit:
    """A slide's gain and shift given the map, by Gauss-Newton with priors, from the gain and shift given."""
    assert response.noise_v is not None
    noise = float(np.hypot(np.median(response.noise_v) / np.sqrt(slide.blocks), LEAST_RESIDUAL_V))
    shift_sd_mm = config.shift_sd_mm if slide.timed else config.untimed_sd_mm
    own = response.at_height(slide.height_mm)

    def model(at: float) -> np.ndarray:
        x, y = slide.place(at, response.lag_s)
        return own.response(x, y, slide.direction_rad, slide.depth_mm)

    for _ in range(ITERATIONS):
        volts = model(shift_mm)
        h = SHIFT_STEP_MM
        slope = gain * (model(shift_mm + h) - model(shift_mm - h)) / (2 * h)
        jacobian = np.stack([volts.ravel(), slope.ravel()], axis=1) / noise
        jacobian = np.vstack([jacobian, np.diag([1 / config.gain_sd, 1 / shift_sd_mm])])
        residuals = np.append(
            (slide.volts - gain * volts).ravel() / noise,
            [(1 - gain) / config.gain_sd, -shift_mm / shift_sd_mm],
        )
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        gain, shift_mm = gain + step[0], shift_mm + step[1]
    return SlideFit(gain, shift_mm, slide.volts - gain * model(shift_mm))

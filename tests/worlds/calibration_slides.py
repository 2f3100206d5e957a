"""Labelled slides over a map that is known, as calibration reads them."""

import numpy as np

from models.response_map.slides import CalibrationSlide


def slides_of(
    response, lines, speeds, gains, noise_v=0.0, seed=0, lag_s=0.0, depths_mm=None
) -> list[CalibrationSlide]:
    """Labelled slides along (direction_deg, offset_mm) lines through the map's chamber, at its depth or at depths."""
    rng = np.random.default_rng(seed)
    slides = []
    depths = np.full(len(lines), response.depth_mm) if depths_mm is None else np.asarray(depths_mm)
    each = zip(lines, speeds, gains, depths.tolist(), strict=True)
    for number, ((direction, offset), speed, gain, depth) in enumerate(each):
        a = np.deg2rad(direction)
        foot = np.array(response.reference_mm) + offset * np.array([-np.sin(a), np.cos(a)])
        start = foot - 36.0 * np.array([np.cos(a), np.sin(a)])
        travelled = np.arange(0.25, 72.0, 0.5)
        blocks = max(1, round(0.5 / speed / 0.02))
        s = travelled - speed * lag_s
        clean = response.response(start[0] + s * np.cos(a), start[1] + s * np.sin(a), a, depth)
        volts = gain * clean + noise_v / np.sqrt(blocks) * rng.standard_normal(clean.shape)
        slides.append(
            CalibrationSlide(
                recording=f"r{number}",
                start_mm=(float(start[0]), float(start[1])),
                direction_rad=a,
                depth_mm=depth,
                travelled_mm=travelled,
                speed_mm_s=np.full(len(travelled), speed),
                volts=volts,
                blocks=blocks,
                step_s=0.5 / speed,
                rest_noise_v=np.full(2, 1.4e-3),
            )
        )
    return slides

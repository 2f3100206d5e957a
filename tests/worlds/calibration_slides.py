"""Labelled slides over a map that is known, as calibration reads them."""

import numpy as np

from softslide.models.response_map.slides import CalibrationSlide


def slides_of(
    response, lines, speeds, gains, noise_v=0.0, lag_s=0.0, depths_mm=None, heights_mm=None, half_mm=36.0
) -> list[CalibrationSlide]:
    """Labelled slides along (direction_deg, offset_mm) lines through the map's chamber, at its depth or at depths, and
    at heights of the skin. half_mm: of each line."""
    rng = np.random.default_rng(0)
    slides = []
    depths = np.full(len(lines), response.depth_mm) if depths_mm is None else np.asarray(depths_mm)
    heights = np.full(len(lines), np.nan) if heights_mm is None else np.asarray(heights_mm)
    each = zip(lines, speeds, gains, depths.tolist(), heights.tolist(), strict=True)
    for number, ((direction, offset), speed, gain, depth, height) in enumerate(each):
        a = np.deg2rad(direction)
        foot = np.array(response.reference_mm) + offset * np.array([-np.sin(a), np.cos(a)])
        start = foot - half_mm * np.array([np.cos(a), np.sin(a)])
        travelled = np.arange(0.25, 2 * half_mm, 0.5)
        blocks = max(1, round(0.5 / speed / 0.02))
        s = travelled - speed * lag_s
        own = response.at(depth, height)
        clean = own.response(start[0] + s * np.cos(a), start[1] + s * np.sin(a), a)
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
                rest_noise_v=np.full(response.channels, 1.4e-3),
                height_mm=height,
            )
        )
    return slides

"""A map over heights of the skin as the model card's section `heights`, with what the static output tells of them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from features.contact.calibration import encoded
from features.height import HeightCalibration
from models.response_map.from_atlas import tilt_v_per_g
from models.response_map.map import ResponseMap
from models.response_map.slides import CalibrationSlide
from models.response_map.static_scatter import LEAST_STATIC_SD_V
from pipeline.atlas.atlas import Atlas
from pipeline.sensor import Sensor


def calibrated_heights(response: ResponseMap, slides: list[CalibrationSlide]) -> HeightCalibration | None:
    """What a device needs to know of the skin's height; None where the slides have one.

    The static output is fitted by a line over the height, by least squares.
    """
    if response.height_slope is None:
        return None
    off_mm = np.array([slide.height_mm - response.height_mm for slide in slides])
    static = np.array([slide.static_v for slide in slides])
    design = np.stack([np.ones_like(off_mm), off_mm], axis=1)
    line = np.linalg.lstsq(design, static, rcond=None)[0]
    sd = np.maximum(np.sqrt(np.mean((static - design @ line) ** 2, axis=0)), LEAST_STATIC_SD_V)
    text, scale = encoded(response.height_slope)
    return HeightCalibration(
        coefficients=text,
        scale_v=scale,
        knots=len(response.height_slope),
        height_mm=response.height_mm,
        lowest_mm=response.height_range_mm[0],
        highest_mm=response.height_range_mm[1],
        static_v=tuple(line[0].tolist()),
        static_v_per_mm=tuple(line[1].tolist()),
        static_sd_v=tuple(sd.tolist()),
    )


def inflation_v_per_mm(
    heights: HeightCalibration | None, atlas: Atlas | None, sensor: Sensor, fit: Mapping[str, float]
) -> tuple[float, ...]:
    """(C,) V/mm, by which the output at rest changes as the skin rises: as recordings of several heights tell it, else
    as the solved design does, on the whole of its way from the flat skin; none: neither is known.

    fit: figures of the calibration; a board that tilts `NAME_gain` times as far in a contact does so at
    rest.
    """
    if heights is not None:
        return heights.static_v_per_mm
    if atlas is None:
        return ()
    tilts_g = atlas.statics[:, :, :2].reshape(len(atlas.height_mm), -1)
    per_mm = atlas.height_mm @ tilts_g / (atlas.height_mm @ atlas.height_mm)
    gain = np.repeat([fit.get(f"{board.name}_gain", 1.0) for board in sensor.accelerometers], 2)
    return tuple((tilt_v_per_g(sensor) * gain * per_mm).tolist())


def with_gains(heights: HeightCalibration, gain: np.ndarray) -> HeightCalibration:
    """The same of a sensor whose channels answer `gain` (C,) times as much. What they show at rest is left as it is."""
    text, scale = encoded(gain * heights.splines())
    return replace(heights, coefficients=text, scale_v=scale)

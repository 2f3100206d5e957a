"""The extremes of an output over a window: their values and their times.

The article's interpolation (5.2.2) uses these alone: the extreme values depend on the distance between the
accelerometer and the sliding line, their times on the speed.
"""

import numpy as np


def maximum(outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest value (...) V and its moment (...) as a fraction of the window, of outputs (..., N) V.

    Refined by the parabola through the largest bin y1 and its neighbours y0, y2: its vertex lies
    d = (y0 - y2) / (2 (y0 - 2 y1 + y2)) bins from the middle one, its value is y1 - (y0 - y2) d / 4. An extreme in the
    first or last bin is not refined: it may not have been reached.
    """
    bins = outputs.shape[-1]
    highest = np.argmax(outputs, axis=-1)
    inner = (highest > 0) & (highest < bins - 1)
    around = np.clip(highest, 1, max(1, bins - 2))[..., None] + np.arange(-1, 2)
    y0, y1, y2 = np.moveaxis(np.take_along_axis(outputs, around, axis=-1), -1, 0)
    curvature = y0 - 2.0 * y1 + y2
    # A plateau of three equal bins has no vertex: its middle bin is taken.
    concave = inner & (curvature < 0)
    shift = np.where(concave, (y0 - y2) / np.where(concave, 2.0 * curvature, 1.0), 0.0)
    value = np.take_along_axis(outputs, highest[..., None], axis=-1)[..., 0]
    return value - 0.25 * (y0 - y2) * shift, (highest + 0.5 + shift) / bins


def minimum(outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest value (...) V and its moment (...), as `maximum` has them."""
    value, moment = maximum(-outputs)
    return -value, moment


def value_at(outputs: np.ndarray, moment: np.ndarray) -> np.ndarray:
    """Outputs (..., N) V at a moment (...) as a fraction of the window, linear between the bins' centres."""
    bins = outputs.shape[-1]
    position = np.clip(moment * bins - 0.5, 0.0, bins - 1.0)
    lower = np.minimum(position.astype(np.intp), bins - 2)
    share = position - lower
    below, above = np.moveaxis(np.take_along_axis(outputs, lower[..., None] + np.arange(2), axis=-1), -1, 0)
    return below + share * (above - below)

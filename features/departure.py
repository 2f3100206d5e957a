"""Where a contact has left the skin: beyond the chamber's rim nothing shows, and no place is known."""

import math

import numpy as np

from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState


def beyond_rim_mm(indenter_mm: float, depth_mm: np.ndarray) -> np.ndarray:
    """How far in mm beyond the clamped rim the centre of a ball that deep in the flat skin still touches it.

    indenter_mm: the ball's diameter 2 R; depth_mm: d. sqrt(2 R d - d^2): there the ball is on the rim's edge.
    """
    return np.sqrt(np.maximum((indenter_mm - depth_mm) * depth_mm, 0.0))


def held_at_rim(estimate: Estimate, chamber_mm: tuple[float, float], indenter_mm: float) -> Estimate:
    """The estimate with the place where the contact left the skin, once it has, and state `ended`; else unchanged.

    chamber_mm: sizes along x and y, centred on 0; the skin around it is clamped. indenter_mm: diameter of the ball, 0
    where it is not known. The place is where the line of motion crosses the border up to which the ball touches the
    skin (`beyond_rim_mm`), going back from the estimate's; a contact that comes in has no such place.
    """
    x, y, speed = estimate.x_mm, estimate.y_mm, math.hypot(estimate.vx_mm_s, estimate.vy_mm_s)
    if not (math.isfinite(x + y) and speed > 0):
        return estimate
    depth = estimate.depth_mm if math.isfinite(estimate.depth_mm) else 0.0
    beyond = float(beyond_rim_mm(indenter_mm, np.asarray(depth)))
    along = (estimate.vx_mm_s / speed, estimate.vy_mm_s / speed)
    # Ways back, in mm, between which the line is over the skin.
    least, most = 0.0, math.inf
    for place, step, size in zip((x, y), along, chamber_mm, strict=True):
        border = size / 2 + beyond
        if abs(step) < 1e-9:
            most = most if abs(place) <= border else -math.inf
            continue
        ends = ((place - border) / step, (place + border) / step)
        least, most = max(least, min(ends)), min(most, max(ends))
    if not 0.0 < least <= most:
        return estimate
    dx, dy = -least * along[0], -least * along[1]
    return estimate._replace(
        state=SlideState.ENDED,
        x_mm=x + dx,
        y_mm=y + dy,
        x_lo_mm=estimate.x_lo_mm + dx,
        x_hi_mm=estimate.x_hi_mm + dx,
        y_lo_mm=estimate.y_lo_mm + dy,
        y_hi_mm=estimate.y_hi_mm + dy,
    )

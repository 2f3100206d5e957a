"""What a skin answers before it is pressed as deep as the atlas begins: while the indenter comes down or lifts off.

An inflated skin stands millimetres over the flat one, so that the indenter travels several millimetres between the
first touch and the atlas's shallowest depth. Over that way the response is taken to grow as a power of the way's share

    response(depth) = response(shallowest) u^p,   u = (depth - touch) / (shallowest - touch),

with the depth `touch` at which the indenter first touches the untouched skin. Exponent and shape of the untouched skin
are fitted to vertical presses that the skin's own solver made; see the log.
"""

import numpy as np

from softslide.pipeline.atlas.atlas import Atlas

# Of u, for accelerometer readings and forces.
EXPONENT = 1.1
# The untouched skin stands height ((1 - (2 x / width)^2) (1 - (2 y / width)^2))^q over the flat one, with q = FLATTER -
# ROUNDER height / width: the higher, the rounder.
FLATTER, ROUNDER = 1.72, 4.1


def touch_depth_mm(x_mm: np.ndarray, y_mm: np.ndarray, height_mm: float, atlas: Atlas) -> np.ndarray:
    """Depth (n,) mm at which an indenter centred at (n,) mm first touches a skin of this height.

    Over the chamber it is minus the skin's height there. Outside, a sphere of radius r meets the chamber's edge, e mm
    away, at the depth r - sqrt(r^2 - e^2); beyond r it touches nothing, which is infinity.
    """
    design = atlas.meta["design"]
    radius = design["indenter_diameter_mm"] / 2
    half_x, half_y = np.array(design["chamber_mm"]) / 2
    dome = np.clip(1 - (x_mm / half_x) ** 2, 0, None) * np.clip(1 - (y_mm / half_y) ** 2, 0, None)
    edge = np.hypot(np.clip(np.abs(x_mm) - half_x, 0, None), np.clip(np.abs(y_mm) - half_y, 0, None))
    beyond = radius - np.sqrt(np.clip(radius**2 - edge**2, 0, None))
    exponent = FLATTER - ROUNDER * height_mm / min(design["chamber_mm"])
    return np.where(edge >= radius, np.inf, beyond - height_mm * dome**exponent)


def share_of_shallowest(depth_mm: np.ndarray, touch_mm: np.ndarray, shallowest_mm: float) -> np.ndarray:
    """u^p (n,): 0 before the touch, 1 from the atlas's shallowest depth on."""
    way = np.maximum(shallowest_mm - touch_mm, 1e-9)
    part = np.clip((depth_mm - touch_mm) / way, 0, 1) ** EXPONENT
    return np.where(depth_mm >= shallowest_mm, 1.0, part)


def partial_friction_parts(
    atlas: Atlas, x_mm: np.ndarray, y_mm: np.ndarray, depth_mm: np.ndarray, height_mm: float
) -> np.ndarray:
    """As `Atlas.friction_parts` (n, 3, channels) at one height, for any depth up to the atlas's deepest.

    Raises:
        InputError: a depth lies beyond the atlas's deepest, or the height outside of its heights.
    """
    shallowest = float(atlas.depth_mm[0])
    parts = atlas.friction_parts(x_mm, y_mm, np.maximum(depth_mm, shallowest), atlas.pressure_at(height_mm))
    touch = touch_depth_mm(x_mm, y_mm, height_mm, atlas)
    return parts * share_of_shallowest(depth_mm, touch, shallowest)[:, None, None]

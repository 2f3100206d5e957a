"""A response map with a formula of a sensing element with three axes, without a rim, in splines of its own spacing."""

import numpy as np

from softslide.features.contact.response_surface import ResponseSurface
from softslide.models.response_map.map import PARTS, ResponseMap

CHAMBER_MM = (30.0, 30.0)
SPACING_MM = 2.0
HALF_MM = 20.0


def dome_map(elements: int = 1, **changes) -> ResponseMap:
    """Two waves and a bell in each element, of 0.1 V, without friction; another phase in each element."""
    # Coefficients at the splines' centres: the surface is a smoothed copy of the formula.
    centres = HALF_MM * np.linspace(-1, 1, round(2 * HALF_MM / SPACING_MM) + 1)
    centres = np.concatenate([[centres[0] - SPACING_MM], centres, [centres[-1] + SPACING_MM]])
    x, y = np.meshgrid(centres, centres, indexing="ij")
    channels = []
    for k in range(elements):
        bell = np.exp(-((x - 3 * k) ** 2 + (y + 4 * k) ** 2) / 300.0)
        channels += [0.1 * np.sin(x / 7 + k), 0.1 * np.sin(y / 8 + k), 0.1 * bell]
    surface = np.stack(channels, axis=2).astype(np.float16).astype(float)
    count = surface.shape[2]
    values = {
        "coefficients": np.stack([surface, *[0 * surface] * (PARTS - 1)]),
        "depth_slope": 0 * surface,
        "chamber_mm": CHAMBER_MM,
        "reference_mm": (0.0, 0.0),
        "noise_v": np.full(count, 1e-3),
        "zero_v": np.full(count, 5e-4),
        "drift_v_s": np.zeros(count),
        "floor_v": 2e-3,
        "gain_sd": 0.1,
        "axes": 3,
        "rim": False,
        "spacing_mm": SPACING_MM,
    }
    return ResponseMap(**{**values, **changes})


def surface_of(response: ResponseMap) -> ResponseSurface:
    """As the device reads it."""
    stack = np.concatenate([response.coefficients, response.depth_slope[None]])
    return ResponseSurface(stack, response.half_mm, response.spacing_mm)

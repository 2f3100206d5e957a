"""A response map with a formula: a board that tilts towards the contact, with slight friction."""

import numpy as np

from softslide.models.response_map.map import PARTS, ResponseMap, spline_coefficients

CHAMBER_MM = (50.0, 50.0)
REFERENCE_MM = (5.0, 0.0)


def bump_map(places: tuple[tuple[float, float], ...] = (REFERENCE_MM,), **changes) -> ResponseMap:
    """V_x = -0.02 u exp(-(u^2 + w^2) / 2 10^2) V with (u, w) from the board, V_y likewise in w; friction adds 2 %.

    places: of the boards. The coefficients are those that half precision holds.
    """
    grid = np.arange(-30.0, 30.5, 1.0)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    tilts, drags = [], []
    for place in places:
        u, w = x - place[0], y - place[1]
        bell = np.exp(-(u**2 + w**2) / 200.0) * np.clip(26.0 - np.maximum(abs(x), abs(y)), 0, 4) / 4
        tilts += [0.02 * u * bell, 0.03 * w * bell]
        drags += [0.004 * bell, 0 * bell]
    tilt, drag = np.stack(tilts, axis=2), np.stack(drags, axis=2)
    across = drag.reshape(*x.shape, -1, 2)[..., ::-1].reshape(drag.shape)
    surfaces = [
        spline_coefficients(values, 30.0).astype(np.float16).astype(float)
        for values in (tilt, drag, across, 0.2 * tilt)
    ]
    values = {
        "coefficients": np.stack(surfaces[:PARTS]),
        "depth_slope": surfaces[PARTS],
        "chamber_mm": CHAMBER_MM,
        "reference_mm": REFERENCE_MM,
        "lag_s": 0.0,
        "noise_v": np.full(2 * len(places), 1.4e-3),
        "zero_v": np.full(2 * len(places), 5e-4),
        "drift_v_s": np.zeros(2 * len(places)),
        "floor_v": 8e-4,
        "gain_sd": 0.02,
    }
    return ResponseMap(**{**values, **changes})

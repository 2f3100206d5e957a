"""A bundle that tracks contacts on the skin of `touched_skin`, and circles on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from dome_map import dome_map
from small_bundle import write_small_bundle
from touched_skin import NOISE, RATE_HZ, SENSOR, UNIT, ZERO

from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.card import contact_calibration

RADIUS_MM, SPEED_MM_S = 7.0, 25.0


def write_touched_bundle(folder: Path) -> Path:
    """Contacts are tracked by the formula's map; the graph has no part in it."""
    scale = 1e-4
    block_v = NOISE * scale / 2  # a block has four samples
    plain = dome_map()
    response = replace(
        plain, coefficients=UNIT * scale * plain.coefficients, noise_v=np.full(3, block_v), floor_v=block_v
    )
    return write_small_bundle(
        folder,
        SENSOR,
        conditioning=Conditioning(
            scale=scale, touch_axes="xyz", onset="touch", trigger_v=1e-3, release_v=5e-4
        ),
        contact=contact_calibration(response),
    )


def at_rest(seconds: float) -> np.ndarray:
    """Subtracted outputs (n, 3) uT of nothing."""
    return np.zeros((round(seconds * RATE_HZ), 3))


def on_the_circle(time_s: np.ndarray) -> np.ndarray:
    """x, y (mm), vx, vy (mm/s) (n, 4) at times since the touch."""
    angle = SPEED_MM_S / RADIUS_MM * time_s
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    return np.concatenate([RADIUS_MM * radial, SPEED_MM_S * along], axis=1)


def circle(turns: float = 1.0) -> np.ndarray:
    """Subtracted outputs (n, 3) uT of so many turns."""
    time_s = np.arange(0.0, turns * 2 * np.pi * RADIUS_MM / SPEED_MM_S, 1 / RATE_HZ)
    return UNIT * dome_map().response(*on_the_circle(time_s)[:, :2].T, 0.0)


def outputs(*parts: np.ndarray) -> np.ndarray:
    """One after the other, with the skin's own field and noise, (n, 3) uT."""
    shown = np.concatenate(parts)
    return ZERO + shown + NOISE * np.random.default_rng(3).standard_normal(shown.shape)

"""Synthetic windows of a board that tilts towards a contact, by a formula with known symmetries."""

import numpy as np

from softslide.features.window import WINDOW_BINS
from softslide.pipeline.recordings.windows import LabelledWindows

_REACH_MM = 8.0
_DOME_MM = 25.0


def slide_window(
    direction_deg: float, offset_mm: float, bins: int = WINDOW_BINS, warp: float = 0.0, stroke: float = 1.0
) -> np.ndarray:
    """volts (3, bins) of one slide over the dome: V = -0.3 r / R exp(-r^2 / 2 R^2), r the contact seen from the board.

    warp bends time without changing the path: 0 is an even speed. stroke: how much of the slide is seen.
    """
    u = stroke * (np.arange(bins) + 0.5) / bins
    s = _DOME_MM * (2.0 * (u + warp * u * (1.0 - u)) - 1.0)
    angle = np.deg2rad(direction_deg)
    x = s * np.cos(angle) - offset_mm * np.sin(angle)
    y = s * np.sin(angle) + offset_mm * np.cos(angle)
    strength = 0.3 * np.exp(-(x**2 + y**2) / (2.0 * _REACH_MM**2)) / _REACH_MM
    return np.stack([x * strength, y * strength, -0.01 * strength * np.hypot(x, y)])


def labelled_slides(directions: np.ndarray, offsets: np.ndarray, seed: int = 0) -> LabelledWindows:
    """A window for each direction, offset and two shares of the stroke, with noise of 0.2 mV; random speeds."""
    rng = np.random.default_rng(seed)
    cases = [(a, o, f) for a in directions for o in offsets for f in (0.8, 1.0)]
    angle, offset, share = np.array(cases).T
    speed = rng.uniform(0.5, 4.0, len(cases))
    volts = np.stack([slide_window(a, o, stroke=f) for a, o, f in cases])
    volts += rng.normal(0.0, 2e-4, volts.shape)
    return LabelledWindows(
        volts=volts.astype(np.float32),
        elapsed_s=2.0 * _DOME_MM * share / speed,
        direction_deg=angle,
        speed_mm_s=speed,
        offset_mm=offset,
        depth_mm=np.full(len(cases), 0.5),
        along_mm=_DOME_MM * (2.0 * share - 1.0),
        stroke_fraction=share,
        recording=np.array([f"s{k // 2:04d}" for k in range(len(cases))]),
        split=np.array(["calibration"] * len(cases)),
    )

"""The curve that a slide traces in the plane of V_x and V_y, resampled by arc length.

The curve depends on the contact's path alone, not on how fast or evenly it moves.
"""

import numpy as np

# A quarter of the window's bins.
ARC_POINTS = 16
# Binomial weights of order 4: noise that alternates from bin to bin averages to zero.
_SMOOTHING = (1 / 16, 4 / 16, 6 / 16, 4 / 16, 1 / 16)


def arc_curve(tilt: np.ndarray, points: int = ARC_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Points (..., 2, points) V at equal steps of arc length along the curve, and its length (...) V.

    tilt: (..., 2, N) V. With l_i = sum_{j <= i} |V_j - V_{j-1}|, the curve is read where l is k / (points - 1) of
    its total, linearly between the bins. A curve without length stays at its first point.
    """
    curve = _smoothed(tilt)
    steps = np.sqrt(np.square(np.diff(curve, axis=-1)).sum(axis=-2))
    length = np.concatenate([np.zeros_like(steps[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)
    total = length[..., -1:]
    targets = total * np.linspace(0.0, 1.0, points)
    passed = (length[..., None, :] <= targets[..., :, None]).sum(axis=-1)
    lower = np.clip(passed - 1, 0, tilt.shape[-1] - 2)
    start = np.take_along_axis(length, lower, axis=-1)
    segment = np.take_along_axis(steps, lower, axis=-1)
    share = np.where(segment > 0, (targets - start) / np.where(segment > 0, segment, 1.0), 0.0)
    share = np.clip(share, 0.0, 1.0)[..., None, :]
    before = np.take_along_axis(curve, lower[..., None, :], axis=-1)
    after = np.take_along_axis(curve, lower[..., None, :] + 1, axis=-1)
    return before + share * (after - before), total[..., 0]


def _smoothed(tilt: np.ndarray) -> np.ndarray:
    """Weighted mean over five bins, the end bins repeated. Noise always lengthens a curve; this removes most of it."""
    padded = np.concatenate([tilt[..., :1], tilt[..., :1], tilt, tilt[..., -1:], tilt[..., -1:]], axis=-1)
    bins = tilt.shape[-1]
    return sum((w * padded[..., k : k + bins] for k, w in enumerate(_SMOOTHING)), np.zeros_like(tilt))

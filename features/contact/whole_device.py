"""Outputs common to all boards: the device tilts, or the pressure in its chamber changes.

A tilt shows alike in all accelerometers, a change of pressure along one known direction of the channels. What an output
has beyond these, something that touches the skin has made. With one accelerometer nothing is beyond them; with two a
direction is left, and each further one leaves two more.
"""

import numpy as np


def beyond_device(inflation_v_per_mm: np.ndarray) -> np.ndarray:
    """The projection (C, C) of outputs (C,) V, V_x and V_y of each accelerometer, on what neither a tilt nor a change
    of pressure makes. inflation_v_per_mm: (C,), by which outputs at rest change as the skin rises; only its direction
    matters."""
    channels = len(inflation_v_per_mm)
    tilts = np.tile(np.eye(2), (channels // 2, 1))
    made = np.column_stack([tilts, inflation_v_per_mm])
    # A pressure that tilts all boards alike, or none, adds no direction of its own.
    directions, sizes, _ = np.linalg.svd(made / np.linalg.norm(made, axis=0).clip(1e-12), full_matrices=False)
    kept = directions[:, sizes > 1e-6]
    return np.eye(channels) - kept @ kept.T

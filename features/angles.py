"""The signed difference of two directions, and the channels that show a tilt or a touch: each defined once."""

from typing import TypeVar

import numpy as np

Angle = TypeVar("Angle", float, np.ndarray)


def wrapped_deg(angle: Angle) -> Angle:
    """The same angle in [-180, 180) deg; of a difference of two directions, the shorter way round, signed."""
    return (angle + 180.0) % 360.0 - 180.0


def tilt_channels(channels: int) -> np.ndarray:
    """Indices (2 A,) of V_x and V_y among `channels` = 3 A channels, each accelerometer's three in the order x, y, z.

    These two follow the sine of the board's tilt under a contact. V_z follows its cosine: it hardly changes.
    """
    return touch_channels(channels, "xy")


def touch_channels(channels: int, axes: str) -> np.ndarray:
    """Indices of the channels that answer to a touch among `channels` = 3 A, each sensing element's in order x, y, z.

    axes: of every element, "xy" (accelerometers, see `tilt_channels`) or "xyz".
    """
    every = np.arange(channels)
    return every[every % 3 < len(axes)]

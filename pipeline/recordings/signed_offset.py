"""The distance of a straight line from the sensor's reference point, and on which side of it the line lies."""

from typing import Any

import numpy as np


def signed_offset(direction_rad: Any, x: Any, y: Any) -> Any:
    """`offset_mm` of the line along a direction through a point x, y mm from the reference point: positive where the
    line lies to the left of the motion. Of numbers, arrays or columns of a table."""
    return np.cos(direction_rad) * y - np.sin(direction_rad) * x

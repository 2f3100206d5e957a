"""The indenter's lines of an atlas: which are needed, which follow by mirror symmetry, and what all of them make.

Results keep their positions in ascending order of the coordinate along the line, whatever the sense of
motion.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from softslide.pipeline.sensor import Sensor

# What is kept of a board's posture, against the untouched inflated skin: gravity in its frame (g), its
# centre's displacement (mm), its rotation about the skin's normal (rad). After the boards: the force on the
# indenter (N).
PER_BOARD = 7
MIRROR_BOARD = (np.array([-1, 1, 1, -1, 1, 1, -1.0]), np.array([1, -1, 1, 1, -1, 1, -1.0]))
MIRROR_FORCE = (np.array([-1, 1, 1.0]), np.array([1, -1, 1.0]))


@dataclass(frozen=True)
class Line:
    """An indenter's line along axis 0 (x) or 1 (y), sense +1 or -1, at an offset along the other in mm."""

    axis: int
    sense: int
    offset_mm: float

    @property
    def name(self) -> str:
        return f"{'xy'[self.axis]}{'-0+'[self.sense + 1]}{self.offset_mm:+08.3f}"

    def centres(self, along_mm: np.ndarray, depth_mm: float, sensor: Sensor) -> np.ndarray:
        """(n, 3) mm of the indenter's centre, `depth_mm` below the flat skin's upper face."""
        centres = np.empty((len(along_mm), 3))
        centres[:, self.axis], centres[:, 1 - self.axis] = along_mm, self.offset_mm
        centres[:, 2] = sensor.skin_thickness_mm + sensor.indenter_diameter_mm / 2 - depth_mm
        return centres


def reach_mm(sensor: Sensor) -> tuple[float, float]:
    """Half sizes (x, y) beyond which an indenter's centre cannot touch the inflated skin."""
    beyond = sensor.skin.overlap_mm + sensor.indenter_diameter_mm / 2
    x, y = (
        side / 2 + beyond + abs(sensor.indenter_edge_mm[k]) / 2 for k, side in enumerate(sensor.chamber_mm)
    )
    return x, y


def mirrored_boards(sensor: Sensor, axis: int) -> tuple[int, ...] | None:
    """The board that each becomes when the design is mirrored in x (0) or y (1); None if asymmetric."""
    places = np.array([(a.x_mm, a.y_mm) for a in sensor.accelerometers])
    images = places * np.where(np.arange(2) == axis, -1.0, 1.0)
    alike = np.linalg.norm(images[:, None] - places, axis=2) < 1e-9
    return tuple(map(int, alike.argmax(axis=1))) if alike.any(axis=1).all() else None


def lines(grids: tuple[np.ndarray, ...], sensor: Sensor) -> list[Line]:
    """Every line along x and along y, forward and backward, that touches. grids: as in `join_families`."""
    reach = reach_mm(sensor)
    return [
        Line(axis, sense, float(offset))
        for axis in (0, 1)
        for sense in (1, -1)
        for offset in grids[2 + axis]
        if abs(offset) < reach[1 - axis] - 1.0
    ]


def lines_to_solve(grids: tuple[np.ndarray, ...], sensor: Sensor) -> list[Line]:
    """Those of `lines` that all follow from by mirroring."""
    return sorted({representative(line, sensor)[0] for line in lines(grids, sensor)}, key=str)


def all_lines(
    solved: Mapping[Line, np.ndarray], grids: tuple[np.ndarray, ...], sensor: Sensor
) -> dict[Line, np.ndarray]:
    """The results (positions, channels) of all `lines`, from those of `lines_to_solve`."""
    found = {}
    for line in lines(grids, sensor):
        of, axes = representative(line, sensor)
        found[line] = solved[of]
        for axis in axes:
            found[line] = mirror(found[line], line, axis, sensor)
    return found


def representative(line: Line, sensor: Sensor) -> tuple[Line, tuple[int, ...]]:
    """The line to be solved instead of this one, and the axes to mirror its result in."""
    axes = []
    for axis in (0, 1):
        if mirrored_boards(sensor, axis) is None:
            continue
        if axis == line.axis and line.sense < 0:
            line = Line(line.axis, 1, line.offset_mm)
            axes.append(axis)
        elif axis != line.axis and line.offset_mm < 0:
            line = Line(line.axis, line.sense, -line.offset_mm)
            axes.append(axis)
    return line, tuple(axes)


def mirror(values: np.ndarray, line: Line, axis: int, sensor: Sensor) -> np.ndarray:
    """Results (positions, channels) of the mirrored line. Of each board there may be the first channels alone."""
    boards = len(sensor.accelerometers)
    other = mirrored_boards(sensor, axis)
    assert other is not None
    posture = values[:, :-3].reshape(len(values), boards, -1)[:, list(other)]
    posture = posture * MIRROR_BOARD[axis][: posture.shape[2]]
    result = np.hstack([posture.reshape(len(values), -1), values[:, -3:] * MIRROR_FORCE[axis]])
    return result[::-1] if axis == line.axis else result


def join_families(
    along: tuple[np.ndarray, np.ndarray], across: tuple[np.ndarray, np.ndarray], grids: tuple[np.ndarray, ...]
) -> np.ndarray:
    """One field and its friction parts from two families of lines, by transfinite interpolation
    (W. J. Gordon, SIAM J. Numer. Anal. 8 (1971) 158).

    With P_y the spline across the lines along x, and P_x the other way, the mean is P_y A + P_x B - P_x P_y
    (A+B)/2: it has the accuracy of the fine spacing along the lines in both directions.

    Args:
        along: lines along x forward and backward, each (nx, lines, channels).
        across: lines along y forward and backward, each (lines, ny, channels).
        grids: x (nx,), y (ny,), and the lines' y and x, which are among them.

    Returns:
        (3, nx, ny, channels): mean, fx, fy.
    """
    x, y, line_y, line_x = grids
    mean_x, part_x = (along[0] + along[1]) / 2, (along[0] - along[1]) / 2
    mean_y, part_y = (across[0] + across[1]) / 2, (across[0] - across[1]) / 2
    on_x = np.searchsorted(x, line_x - 1e-9)
    on_y = np.searchsorted(y, line_y - 1e-9)
    over_y = lambda values: make_interp_spline(line_y, values, axis=1)(y)  # noqa: E731
    over_x = lambda values: make_interp_spline(line_x, values, axis=0)(x)  # noqa: E731
    crossing = (mean_x[on_x] + mean_y[:, on_y]) / 2
    mean = over_y(mean_x) + over_x(mean_y) - over_x(over_y(crossing))
    return np.stack([mean, over_y(part_x), over_x(part_y)])

"""The skin without boards: how it tilts everywhere under a sliding contact, so that boards can be placed.

Where a board would lie, its tilt is taken for that of the plane through the skin's middle over the board's area. A real
board stiffens the skin around it; one solve stands for boards at any place, an atlas for one arrangement.
"""

from dataclasses import dataclass, replace

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.solve import COARSE, Progress, on_grid
from softslide.pipeline.sensor import RIM_MM, Accelerometer, Sensor
from softslide.pipeline.skin.lines import Line, lines, reach_mm, representative
from softslide.pipeline.skin.mesh import Mesh, graded, mounted, outline, plate
from softslide.pipeline.skin.solved_line import material_of
from softslide.pipeline.skin.solver import NoEquilibrium, Skin
from softslide.pipeline.skin.system import State

MESH_MM = 3.4  # as coarse as the coarse atlas's
LAYERS = 3
PLACE_STEP_MM = 2.5


@dataclass(frozen=True)
class TiltField:
    """Tilts (g) of boards at `places_mm` (P, 2) under contacts on the grid x_mm (nx,), y_mm (ny,).

    parts: (3, nx, ny, P, 2), mean, fx and fy of the readings along x and y, as an atlas has them.
    """

    places_mm: np.ndarray
    x_mm: np.ndarray
    y_mm: np.ndarray
    parts: np.ndarray
    height_mm: float
    depth_mm: float


def board_places(sensor: Sensor) -> np.ndarray:
    """Where a board of this design fits into the chamber: (P, 2) mm, a grid that is symmetric in x and y.

    Raises:
        InputError: a board fits nowhere.
    """
    axes = []
    for size, board in zip(sensor.chamber_mm, sensor.board.size_mm, strict=True):
        reach = (size - board) / 2 - RIM_MM
        if reach < 0:
            raise InputError(f"{sensor.name}: a board of {board:g} mm does not fit a chamber of {size:g} mm")
        steps = np.arange(-np.floor(reach / PLACE_STEP_MM), np.floor(reach / PLACE_STEP_MM) + 1)
        axes.append(PLACE_STEP_MM * steps)
    x, y = np.meshgrid(*axes, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()])


def solve_tilts(
    sensor: Sensor, height_mm: float, depth_mm: float, progress: Progress | None = None
) -> TiltField:
    """Solves the bare skin of a design at one height and depth, in about a minute on one core.

    Raises:
        InputError: the height is beyond the skin's limit, or a line has no equilibrium.
    """
    places = board_places(sensor)
    # A single board at the centre has all the symmetry of the bare skin, and so needs the same lines.
    symmetric = replace(sensor, accelerometers=(Accelerometer("none", 0.0, 0.0),))
    grid_x, grid_y = (graded([*ends, 0.0], MESH_MM) for ends in outline(sensor))
    z = np.linspace(0, sensor.skin_thickness_mm, LAYERS + 1)
    mesh = mounted(plate(grid_x, grid_y, z, np.zeros((0, 2)), np.zeros(2), (0, 0)), sensor)
    skin = Skin(mesh, material_of(sensor))
    try:
        pressure, inflated = skin.inflate_to(height_mm)
    except NoEquilibrium as error:
        raise InputError(
            f"{height_mm:g} mm is beyond the skin's limit ({error}); lower it", "height"
        ) from None
    reach = reach_mm(sensor)
    (line_x, x), (line_y, y) = (COARSE.axis(r) for r in reach)
    every = lines((line_x, line_y), symmetric)
    wanted = sorted({representative(line, symmetric)[0] for line in every}, key=str)
    reader = _Reader(mesh, places, np.array(sensor.board.size_mm) / 2)
    rest = reader.tilts(skin, inflated)
    solved: dict[Line, np.ndarray] = {}
    for line in progress(wanted, len(wanted)) if progress else wanted:
        postures, _ = skin.slide(inflated, pressure, line.centres((x, y)[line.axis], depth_mm, sensor))
        tilts = [reader.tilts(skin, posture) for posture in postures if posture is not None]
        if len(tilts) < len(postures):
            raise InputError(
                f"{sensor.name}: the bare skin has no equilibrium under the contact of line {line.name}; lower the "
                "height"
            )
        solved[line] = np.array(tilts) - rest
    mirrored = {line: _mirrored(line, symmetric, solved, places) for line in every}
    parts = on_grid(mirrored, (x, y, line_y, line_x))
    return TiltField(places, x, y, parts.reshape(*parts.shape[:3], len(places), 2), height_mm, depth_mm)


class _Reader:
    """Reads a posture's tilts at the places: the least-squares plane through the skin's two middle layers of nodes.

    places: (P, 2) mm; reach: (2,) half sizes of a board, mm.
    """

    def __init__(self, mesh: Mesh, places: np.ndarray, reach: np.ndarray) -> None:
        levels = np.unique(mesh.nodes[:, 2])
        middle = np.isin(mesh.nodes[:, 2], levels[1:-1])
        self._nodes = np.flatnonzero(middle)
        flat = mesh.nodes[middle, :2]
        # Half an element beyond the board, so that there are always nodes on both sides.
        near = (np.abs(flat - places[:, None]) <= reach + MESH_MM / 2).all(axis=2)
        self._weights = np.zeros((2, len(places), len(flat)))
        for p, own in enumerate(near):
            basis = np.column_stack([np.ones(own.sum()), flat[own] - places[p]])
            self._weights[:, p, own] = np.linalg.pinv(basis)[1:]

    def tilts(self, skin: Skin, state: State) -> np.ndarray:
        """(2 P,) g: each place's reading along x and y, with the signs of `pipeline.skin.solved_line.gravity`."""
        axes = self._weights @ skin.system.places(state)[self._nodes]
        return -(axes[..., 2] / np.linalg.norm(axes, axis=-1)).T.ravel()


def _mirrored(
    line: Line, symmetric: Sensor, solved: dict[Line, np.ndarray], places: np.ndarray
) -> np.ndarray:
    """One line's tilts (n, 2 P), mirrored from the line that was solved instead of it."""
    of, axes = representative(line, symmetric)
    values = solved[of].reshape(-1, len(places), 2)
    for axis in axes:
        image = places * np.where(np.arange(2) == axis, -1.0, 1.0)
        order = np.array([int(np.flatnonzero(np.isclose(places, p).all(axis=1))[0]) for p in image])
        values = values[:, order] * np.where(np.arange(2) == axis, -1.0, 1.0)
        if axis == line.axis:
            values = values[::-1]
    return values.reshape(len(values), -1)

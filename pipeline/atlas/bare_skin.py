"""The skin without boards: how it tilts everywhere under a sliding contact, so that boards can be placed.

Where a board would lie, its tilt is taken for that of the plane through the skin's middle over the board's area. A real
board stiffens the skin around it; one solve stands for boards at any place, an atlas for one arrangement.
"""

from dataclasses import dataclass, replace

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.solve import COARSE, Progress, on_grid
from softslide.pipeline.sensor import RIM_MM, Accelerometer, Sensor
from softslide.pipeline.skin.lines import Line, all_lines, lines_to_solve
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
    grids = COARSE.axes(sensor)
    # As if there were a board at each place: symmetric as the bare skin is.
    boards = tuple(Accelerometer(f"a{n}", float(x), float(y)) for n, (x, y) in enumerate(places))
    everywhere = replace(sensor, accelerometers=boards)
    wanted = lines_to_solve(grids, everywhere)
    nodes, weights = _middle_planes(mesh, places, np.array(sensor.board.size_mm) / 2)

    def tilts(posture: State) -> np.ndarray:
        """(2 P,) g: each place's reading along x and y, with the signs of `pipeline.skin.solved_line.gravity`."""
        axes = weights @ skin.system.places(posture)[nodes]
        return -(axes[..., 2] / np.linalg.norm(axes, axis=-1)).T.ravel()

    solved: dict[Line, np.ndarray] = {}
    for line in progress(wanted, len(wanted)) if progress else wanted:
        postures, forces = skin.slide(inflated, pressure, line.centres(grids[line.axis], depth_mm, sensor))
        read = [tilts(posture) for posture in postures if posture is not None]
        if len(read) < len(postures):
            raise InputError(
                f"{sensor.name}: the bare skin has no equilibrium under the contact of line {line.name}; lower the "
                "height"
            )
        solved[line] = np.column_stack([np.array(read) - tilts(inflated), forces])
    parts = on_grid(all_lines(solved, grids, everywhere), grids)[..., :-3]
    x, y = grids[:2]
    return TiltField(places, x, y, parts.reshape(*parts.shape[:3], len(places), 2), depth_mm)


def _middle_planes(mesh: Mesh, places: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (m,) of the skin's two middle layers, and weights (2, P, m): their products with the nodes' places are the
    slopes along x and y of the least-squares plane through those near each of the places (P, 2) mm.

    reach: (2,) half sizes of a board, mm.
    """
    levels = np.unique(mesh.nodes[:, 2])
    nodes = np.flatnonzero(np.isin(mesh.nodes[:, 2], levels[1:-1]))
    flat = mesh.nodes[nodes, :2]
    # Half an element beyond the board, so that there are always nodes on both sides.
    near = (np.abs(flat - places[:, None]) <= reach + MESH_MM / 2).all(axis=2)
    weights = np.zeros((2, len(places), len(flat)))
    for p, own in enumerate(near):
        basis = np.column_stack([np.ones(own.sum()), flat[own] - places[p]])
        weights[:, p, own] = np.linalg.pinv(basis)[1:]
    return nodes, weights

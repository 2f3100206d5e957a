"""The skin as hexahedra: a plate over the chamber with rigid boards cast into its middle layer.

Coordinates in mm: x and y from the chamber's centre, z from the skin's lower face. The plate ends at the
chamber's edge, where it is clamped over its whole thickness, or goes on beyond it (`overlap_mm` of the design):
there its lower face is bonded to the base, which is rigid or gives way elastically.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from softslide.pipeline.sensor import Sensor

# Corners of the reference element in the order of the nodes: the lower face counter-clockwise, then the
# upper one.
CORNERS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]],
    float,
)


@dataclass(frozen=True)
class Mesh:
    """Nodes, elements, and which of them are held, pressed, touched or part of a board."""

    nodes: np.ndarray  # (n, 3) mm
    elements: np.ndarray  # (e, 8) int32, ordered as CORNERS, without the boards' own
    clamped: np.ndarray  # (n,) bool
    board_of: np.ndarray  # (n,) int32: the node's board, or -1
    centres: np.ndarray  # (boards, 3) mm
    is_bottom: np.ndarray  # (e,) bool: nodes 0..3 are a face that the pressure acts on
    is_top: np.ndarray  # (e,) bool: nodes 4..7 are a face that the indenter can touch
    springs: np.ndarray  # (n, 3) N/mm: what holds a node that is not clamped at its place
    prestretch: float = 1.0  # along x and y, from the stress-free skin to `nodes`; the volume is kept

    @property
    def gradients(self) -> tuple[np.ndarray, np.ndarray]:
        """Shape-function gradients (e, 8 points, 8 nodes, 3) in 1/mm over the stress-free skin, and volumes
        (e, 8 points) in mm^3."""
        points = CORNERS / np.sqrt(3.0)
        jacobian = np.einsum("qai,eaj->eqij", shape_gradients(points), self.nodes[self.elements])
        inverse = np.linalg.inv(jacobian)
        gradients = np.einsum("eqji,qai->eqaj", inverse, shape_gradients(points))
        gradients *= [self.prestretch, self.prestretch, self.prestretch**-2]
        return np.ascontiguousarray(gradients), np.linalg.det(jacobian)

    @property
    def face_areas(self) -> np.ndarray:
        """(e,) mm^2: the upper faces' areas as cast."""
        corners = self.nodes[self.elements[:, 4:]]
        diagonals = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        return np.linalg.norm(diagonals, axis=1) / 2


def shape_gradients(points: np.ndarray) -> np.ndarray:
    """dN_a/dxi_i of the trilinear element at reference points (q, 3), as (q, 8, 3)."""
    factors = 1.0 + points[:, None, :] * CORNERS  # (q, 8, 3)
    x, y, z = (factors[..., i] for i in range(3))
    return np.stack([CORNERS[:, 0] * y * z, CORNERS[:, 1] * x * z, CORNERS[:, 2] * x * y], axis=-1) / 8.0


def skin_mesh(sensor: Sensor) -> Mesh:
    """The mesh of a design, aligned with its boards' edges."""
    boards = np.array([(a.x_mm, a.y_mm) for a in sensor.accelerometers])
    reach = np.array(sensor.board.size_mm) / 2
    x, y = (
        graded(
            [*outline(sensor)[i], *(boards[:, i] - reach[i]), *(boards[:, i] + reach[i])], sensor.mesh.size_mm
        )
        for i in range(2)
    )
    below = (sensor.skin_thickness_mm - sensor.board.thickness_mm) / 2
    layers = sensor.mesh.layers
    z = np.concatenate(
        [
            np.linspace(0, below, layers + 1)[:-1],
            np.linspace(below, below + sensor.board.thickness_mm, layers + 1),
            np.linspace(below + sensor.board.thickness_mm, sensor.skin_thickness_mm, layers + 1)[1:],
        ]
    )
    return mounted(plate(x, y, z, boards, reach, (layers, 2 * layers)), sensor)


def outline(sensor: Sensor) -> list[list[float]]:
    """Where the chamber and the skin end along x and along y, mm."""
    return [
        sorted({sign * (side / 2 + beyond) for sign in (-1, 1) for beyond in (0.0, sensor.skin.overlap_mm)})
        for side in sensor.chamber_mm
    ]


def mounted(mesh: Mesh, sensor: Sensor) -> Mesh:
    """A plate that ends where `outline` says, held as the design's skin is."""
    skin = sensor.skin
    mesh = replace(mesh, prestretch=skin.prestretch)
    if not skin.overlap_mm:
        return mesh
    half = np.array(sensor.chamber_mm) / 2
    over_base = ~(np.abs(mesh.nodes[mesh.elements, :2].mean(axis=1)) < half).all(axis=1)
    bonded = mesh.elements[mesh.is_bottom & over_base, :4]
    clamped, springs = np.zeros_like(mesh.clamped), np.zeros_like(mesh.springs)
    if skin.base_mpa_mm:
        normal, tangential = skin.base_mpa_mm
        # A node's share of the faces round it.
        sides = mesh.nodes[bonded[:, 2], :2] - mesh.nodes[bonded[:, 0], :2]
        share = np.repeat(sides.prod(axis=1)[:, None] / 4, 4, axis=1)
        np.add.at(springs, bonded, share[..., None] * [tangential, tangential, normal])
    else:
        clamped[bonded] = True
    return replace(mesh, clamped=clamped, springs=springs, is_bottom=mesh.is_bottom & ~over_base)


def plate(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    boards: np.ndarray,
    reach: np.ndarray,
    board_layers: tuple[int, int],
) -> Mesh:
    """A plate on the grid x (nx), y (ny), z (nz) mm, clamped at its sides.

    Args:
        boards: (boards, 2) centres; `reach` (2,) half sizes; both mm, edges on grid lines.
        board_layers: the boards fill the layers first <= k < last.
    """
    nx, ny, nz = len(x), len(y), len(z)
    grid = np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], axis=-1)
    nodes = grid.reshape(-1, 3)
    index = np.arange(nx * ny * nz, dtype=np.int32).reshape(nz, ny, nx)
    low, high = index[:-1], index[1:]
    quad = lambda layer: (layer[:, :-1, :-1], layer[:, :-1, 1:], layer[:, 1:, 1:], layer[:, 1:, :-1])  # noqa: E731
    elements = np.stack([*quad(low), *quad(high)], axis=-1).reshape(-1, 8)
    layer = np.repeat(np.arange(nz - 1), (ny - 1) * (nx - 1))

    middle = nodes[elements].mean(axis=1)
    first, last = board_layers
    in_layers = (layer >= first) & (layer < last)
    inside = np.zeros(len(elements), bool)
    board_of = np.full(len(nodes), -1, np.int32)
    for n, centre in enumerate(boards):
        own = in_layers & (np.abs(middle[:, :2] - centre) < reach).all(axis=1)
        inside |= own
        board_of[np.unique(elements[own])] = n
    centres = np.column_stack([boards, np.full(len(boards), (z[first] + z[last]) / 2)])

    side = np.zeros((nz, ny, nx), bool)
    side[:, [0, -1], :] = side[:, :, [0, -1]] = True
    return Mesh(
        nodes,
        np.ascontiguousarray(elements[~inside]),
        side.ravel(),
        board_of,
        centres,
        layer[~inside] == 0,
        layer[~inside] == nz - 2,
        np.zeros_like(nodes),
    )


def graded(marks: list[float], size: float) -> np.ndarray:
    """Grid lines through all marks, and between two of them evenly, about `size` apart."""
    edges = np.unique(np.round(marks, 9))
    lines = [np.linspace(a, b, max(1, round((b - a) / size)) + 1)[:-1] for a, b in pairwise(edges)]
    return np.concatenate([*lines, edges[-1:]])

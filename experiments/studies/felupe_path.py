"""The same skin, air and indenter in FElupe, stepped along the same path: the reference of `skin_speed` and a test.

FElupe brings elements, assembly, Newton's method and its linear solver; the indenter's traction, which it has not at
quadrature points, is this project's compiled one. The board is a solid thirty thousand times as stiff.
"""

from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sparse

from softslide.pipeline.skin import loads
from softslide.pipeline.skin.mesh import Mesh
from softslide.pipeline.skin.solver import Skin
from softslide.pipeline.skin.system import Material

# Residual force over the reaction: about the solver's own tolerance, 3e-4 N.
TOLERANCE = 1e-4
SHORTEST_PART = 1 / 16


class Contact:
    """The indenter as an item that FElupe assembles: nodal forces (3 n, 1) N, their tangent (3 n, 3 n) N/mm."""

    def __init__(self, field: Any, mesh: Mesh, material: Material) -> None:
        self.field, self.mesh = field, mesh
        self.elements = mesh.elements[mesh.is_top].astype(int)
        self.areas = mesh.face_areas[mesh.is_top] / loads.POINTS**2
        self.law = material.touch_law
        self.centre = self.before = np.array([1e3, 0.0, 0.0])
        self.old = mesh.nodes.copy()
        self.results = SimpleNamespace(update_statevars=lambda: None)
        vector, matrix = (lambda field=None, n=n, **_: self._sum(n == 1)[n] for n in (0, 1))
        self.assemble = SimpleNamespace(vector=vector, matrix=matrix, multiplier=None)

    def _sum(self, wants_tangent: bool) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        places, moved = self.mesh.nodes + self.field[0].values, self.centre - self.before
        indenter = (self.centre, moved, self.law)
        total, forces = np.zeros(4), np.zeros_like(places)
        at, values = [np.zeros((2, 0), int)], [np.zeros(0)]
        # Faces whose nodes are all far from the indenter are not in contact.
        near = np.hypot(*(places[self.elements[:, 4]] - self.centre)[:, :2].T) < self.law[0] + 8.0
        for element, area in zip(self.elements[near], self.areas[near], strict=True):
            force, block = np.zeros((3, 8, 1)), np.zeros((8, 8, 3, 3, 1))
            x, before = places[element].T[..., None], self.old[element].T
            loads.touch(0, x, before, area, indenter, wants_tangent, force, block, total)
            np.add.at(forces, element, force[..., 0].T)
            unknowns = (3 * element[:, None] + np.arange(3)).ravel()
            at.append(np.stack(np.meshgrid(unknowns, unknowns, indexing="ij")).reshape(2, -1))
            values.append(block[..., 0].transpose(0, 2, 1, 3).ravel())
        where, size = np.concatenate(at, axis=1), (places.size, places.size)
        tangent = sparse.csr_matrix((np.concatenate(values), where), shape=size)
        return sparse.csr_matrix(forces.reshape(-1, 1)), tangent


def felupe_path(
    skin: Skin, pressure_mpa: float, centres: np.ndarray, inflating: Callable, solvers: Sequence[Callable]
) -> Iterator[np.ndarray]:
    """Places of the nodes (n, 3) mm: first of the inflated skin, then at each indenter centre (m, 3) mm.

    inflating, solvers (one a centre): solve sparse systems as `scipy.sparse.linalg.spsolve` does.
    """
    import felupe as fem

    def field(cells: np.ndarray) -> Any:
        region = fem.RegionHexahedron(fem.Mesh(mesh.nodes, cells, "hexahedron"))
        return fem.FieldContainer([fem.Field(region, dim=3)])

    mesh, material = skin.mesh, skin.material
    soft, hard = mesh.elements.astype(int), board_elements(mesh)
    now = field(np.vstack([soft, hard]))
    below = fem.RegionHexahedronBoundary(now.region.mesh, mask=mesh.nodes[:, 2] == 0)
    air = fem.SolidBodyPressure(fem.FieldContainer([fem.Field(below, dim=3)]))
    contact = Contact(now, mesh, material)
    solid = fem.SolidBodyNearlyIncompressible
    rubber = solid(fem.NeoHooke(mu=material.shear_mpa), field(soft), bulk=material.bulk_mpa)
    board = solid(fem.NeoHooke(mu=700.0), field(hard), bulk=2000.0)
    held, free = fem.dof.partition(now, {"rim": fem.Boundary(now[0], mask=mesh.clamped)})
    system = {"items": [rubber, board, air, contact], "x0": now, "dof0": held, "dof1": free}

    def balance(start: np.ndarray, by: Callable) -> np.ndarray:
        now[0].values[:] = start
        fem.newtonraphson(**system, ext0=np.zeros(len(held)), tol=TOLERANCE, verbose=0, solver=by)
        return now[0].values.copy()

    moved = np.zeros_like(mesh.nodes)
    for air.results.pressure in np.arange(1e-4, pressure_mpa + 5e-5, 1e-4):
        moved = balance(moved, inflating)
    yield mesh.nodes + moved
    contact.before = centres[0]
    for centre, solver in zip(centres, solvers, strict=True):
        begin, done, part = contact.before, 0.0, 1.0
        while done < 1 - 1e-9:
            contact.old = mesh.nodes + moved
            contact.before, contact.centre = (begin + s * (centre - begin) for s in (done, done + part))
            try:
                moved = balance(moved, solver)
                done += part
            except (ArithmeticError, RuntimeError, ValueError):
                part /= 2
                if part < SHORTEST_PART:
                    raise
        contact.before = centre
        yield mesh.nodes + moved


def board_elements(mesh: Mesh) -> np.ndarray:
    """(e, 8) the elements that the first rigid board replaces, in the mesh's order of nodes."""
    own = np.flatnonzero(mesh.board_of == 0)
    sizes = [len(np.unique(mesh.nodes[own, i])) for i in (2, 1, 0)]
    grid = own[np.lexsort(mesh.nodes[own].T)].reshape(sizes)
    k, j, i = np.indices([size - 1 for size in sizes]).reshape(3, -1)
    around = ((0, 0), (0, 1), (1, 1), (1, 0))
    return np.stack([grid[k + c, j + b, i + a] for c in (0, 1) for b, a in around], axis=-1)

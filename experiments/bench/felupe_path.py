"""The same skin, air and indenter in FElupe, stepped along the same path: the benchmark's reference solver.

FElupe brings elements, assembly, Newton's method and its linear solver; the indenter's traction, which it has not at
quadrature points, is this project's compiled one. The board is a solid thirty thousand times as stiff.
"""

from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sparse

from pipeline.skin import loads
from pipeline.skin.mesh import Mesh
from pipeline.skin.system import Material

# Residual force over the reaction: about the solver's own tolerance, 3e-4 N.
TOLERANCE = 1e-4
SHORTEST_PART = 1 / 16


class Contact:
    """The indenter as an item that FElupe assembles."""

    def __init__(self, field: Any, mesh: Mesh, material: Material) -> None:
        self.field, self.mesh = field, mesh
        self.elements = mesh.elements[mesh.is_top].astype(int)
        corners = mesh.nodes[self.elements[:, 4:]]
        across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
        self.areas = np.linalg.norm(across, axis=1) / 2 / loads.POINTS**2
        self.law, self.shapes = material.touch_law, loads.face_shapes()
        self.centre = self.before = np.array([1e3, 0.0, 0.0])
        self.old = mesh.nodes.copy()
        self.results = SimpleNamespace(update_statevars=lambda: None)
        self.assemble = SimpleNamespace(vector=self.vector, matrix=self.matrix, multiplier=None)

    def vector(self, field: Any = None, **_: Any) -> sparse.csr_matrix:
        """Nodal forces (3 n, 1) N."""
        return self._sum(False)[0]

    def matrix(self, field: Any = None, **_: Any) -> sparse.csr_matrix:
        """Their tangent (3 n, 3 n) N/mm."""
        return self._sum(True)[1]

    def _sum(self, wants_tangent: bool) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        places = self.mesh.nodes + self.field[0].values
        moved = self.centre - self.before
        travel, total = float(np.linalg.norm(moved)), np.zeros(4)
        forces = np.zeros_like(places)
        size = places.size
        rows, columns, values = [], [], []
        # Faces whose nodes are all far from the indenter are not in contact.
        near = np.hypot(*(places[self.elements[:, 4]] - self.centre)[:, :2].T) < self.law[0] + 8.0
        for element, area in zip(self.elements[near], self.areas[near], strict=True):
            force, block = np.zeros((3, 8, 1)), np.zeros((8, 8, 3, 3, 1))
            x, before = places[element].T[..., None], self.old[element].T
            loads.touch(
                0,
                x,
                before,
                area,
                self.centre,
                moved,
                travel,
                self.law,
                self.shapes,
                wants_tangent,
                force,
                block,
                total,
            )
            np.add.at(forces, element, force[..., 0].T)
            if wants_tangent and block.any():
                unknowns = 3 * element[:, None] + np.arange(3)
                rows.append(np.broadcast_to(unknowns[:, :, None, None], (8, 3, 8, 3)).ravel())
                columns.append(np.broadcast_to(unknowns[None, None], (8, 3, 8, 3)).ravel())
                values.append(block[..., 0].transpose(0, 2, 1, 3).ravel())
        none = [np.zeros(0, int)]
        at = (np.concatenate(rows or none), np.concatenate(columns or none))
        tangent = sparse.csr_matrix((np.concatenate(values or [np.zeros(0)]), at), shape=(size, size))
        return sparse.csr_matrix(forces.reshape(-1, 1)), tangent


def felupe_path(
    mesh: Mesh,
    material: Material,
    pressure_mpa: float,
    centres: np.ndarray,
    inflating: Callable,
    solvers: Sequence[Callable],
) -> Iterator[np.ndarray]:
    """Places of the nodes (n, 3) mm: first of the inflated skin, then at each indenter centre (m, 3) mm.

    inflating, solvers (one a centre): solve sparse systems as `scipy.sparse.linalg.spsolve` does.
    """
    import felupe as fem

    soft, hard = mesh.elements.astype(int), board_elements(mesh)
    skin, board, now = (
        fem.FieldContainer([fem.Field(fem.RegionHexahedron(fem.Mesh(mesh.nodes, c, "hexahedron")), dim=3)])
        for c in (soft, hard, np.vstack([soft, hard]))
    )
    below = fem.RegionHexahedronBoundary(now.region.mesh, mask=mesh.nodes[:, 2] == 0)
    air = fem.SolidBodyPressure(fem.FieldContainer([fem.Field(below, dim=3)]))
    contact = Contact(now, mesh, material)
    items = [
        fem.SolidBodyNearlyIncompressible(fem.NeoHooke(mu=material.shear_mpa), skin, bulk=material.bulk_mpa),
        fem.SolidBodyNearlyIncompressible(fem.NeoHooke(mu=700.0), board, bulk=2000.0),
        air,
        contact,
    ]
    held, free = fem.dof.partition(now, {"rim": fem.Boundary(now[0], mask=mesh.clamped)})

    def balance(start: np.ndarray, by: Callable) -> np.ndarray:
        now[0].values[:] = start
        fem.newtonraphson(
            items=items,
            x0=now,
            dof0=held,
            dof1=free,
            ext0=np.zeros(len(held)),
            tol=TOLERANCE,
            verbose=0,
            solver=by,
        )
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
    x, y, z = (np.unique(mesh.nodes[own, i]) for i in range(3))
    at = {tuple(np.round(mesh.nodes[n], 6)): n for n in own}
    corners = ((0, 0), (1, 0), (1, 1), (0, 1))
    return np.array(
        [
            [at[tuple(np.round((x[i + a], y[j + b], z[k + c]), 6))] for c in (0, 1) for a, b in corners]
            for k in range(len(z) - 1)
            for j in range(len(y) - 1)
            for i in range(len(x) - 1)
        ]
    )

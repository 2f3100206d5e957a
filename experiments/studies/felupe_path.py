"""The same skin, air and indenter in FElupe, stepped along the same path: the reference of `skin_speed` and a test.

FElupe brings elements, assembly, Newton's method and its linear solver; the indenter's traction, which it has not at
quadrature points, is this project's compiled one. The board is a solid thirty thousand times as stiff.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse as sparse

from softslide.pipeline.skin.mesh import Mesh
from softslide.pipeline.skin.solver import Skin
from softslide.pipeline.skin.system import Load, Material, State, System

# Residual force over the reaction: about the solver's own tolerance, 3e-4 N.
TOLERANCE = 1e-4
SHORTEST_PART = 1 / 16


class Contact:
    """The indenter as an item that FElupe assembles: nodal forces (3 n, 1) N, their tangent (3 n, 3 n) N/mm.

    They are those of a skin without stiffness, whose nodes are all free.
    """

    def __init__(self, field: Any, mesh: Mesh, material: Material) -> None:
        self.field, free = field, replace(mesh, clamped=np.zeros_like(mesh.clamped))
        free = replace(free, board_of=np.full_like(mesh.board_of, -1), centres=mesh.centres[:0])
        self.limp = System(free, replace(material, shear_mpa=0.0, bulk_mpa=0.0))
        self.centre = self.before = np.array([1e3, 0.0, 0.0])
        self.old = mesh.nodes.copy()
        self.results = SimpleNamespace(update_statevars=lambda: None)
        self.assemble = SimpleNamespace(vector=self._force, matrix=self._tangent, multiplier=None)

    def _force(self, field: Any = None, wants_tangent: bool = False, **_: Any) -> sparse.csr_matrix:
        state = State(self.field[0].values.ravel(), np.zeros((0, 3, 3)))
        load = Load(0.0, self.centre, self.before, self.old)
        force = self.limp.residual(state, load, wants_tangent)[0]
        if force is None:
            raise ArithmeticError("an element is inside out")
        return sparse.csr_matrix(force[:, None])

    def _tangent(self, field: Any = None, **_: Any) -> sparse.csr_matrix:
        self._force(wants_tangent=True)
        return self.limp.pattern + sparse.triu(self.limp.pattern, 1).T


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

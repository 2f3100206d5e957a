"""The skin's equations: nodes and rigid boards as one vector of unknowns, residual and tangent.

A board is six unknowns: a displacement d of its centre and a rotation w since the last accepted position,
so that a node of it with the arm r0 (rotated by what was accepted) lies at X_c + d + exp(w) r0. Virtual
motion of that node: delta d + (T(w) delta w) x r, hence B = [I, -[r]x T]. Elements are summed into the
upper triangle of one sparse matrix whose pattern never changes, with B^T K B wherever a node belongs to a
board.
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sparse

from softslide.pipeline.skin import loads, material
from softslide.pipeline.skin.assembly import sum_elements
from softslide.pipeline.skin.mesh import Mesh


@dataclass(frozen=True)
class Material:
    """Moduli in MPa, friction without unit, the indenter's radius in mm and the vector along its edge."""

    shear_mpa: float
    bulk_mpa: float
    friction: float
    radius_mm: float
    edge_mm: tuple[float, float] = (0.0, 0.0)

    @property
    def touch_law(self) -> np.ndarray:
        """(6,) as `loads.touch` takes it."""
        half = (self.edge_mm[0] / 2, self.edge_mm[1] / 2)
        return np.array([self.radius_mm, self.friction, loads.STIFFNESS, loads.SLIP, *half])


@dataclass
class State:
    """A posture of the skin: the unknowns since the boards' last accepted rotations."""

    unknowns: np.ndarray  # (n,) mm, and rad for the boards' rotations
    rotations: np.ndarray  # (boards, 3, 3): each board's accepted rotation

    def copy(self) -> "State":
        return State(self.unknowns.copy(), self.rotations.copy())


@dataclass(frozen=True)
class Load:
    """Air in MPa and the indenter's way from `before` to `centre` (3,) mm; no indenter if None."""

    pressure_mpa: float
    centre: np.ndarray | None = None
    before: np.ndarray | None = None
    old_places: np.ndarray | None = None  # (nodes, 3) mm at `before`


@dataclass
class System:
    """Pattern, constants and work space of one mesh. Not shared between threads."""

    mesh: Mesh
    material: Material
    first: np.ndarray = field(init=False)  # (nodes,) first unknown, -1 where clamped
    count: np.ndarray = field(init=False)  # (nodes,) 0, 3 or 6 unknowns
    size: int = field(init=False)
    pattern: sparse.csr_matrix = field(init=False)  # upper triangle; its data is overwritten

    def __post_init__(self) -> None:
        mesh = self.mesh
        boards = len(mesh.centres)
        free = ~mesh.clamped & (mesh.board_of < 0)
        self.first = np.full(len(mesh.nodes), -1, np.int32)
        self.first[free] = 3 * np.arange(free.sum())
        on_board = mesh.board_of >= 0
        self.first[on_board] = 3 * free.sum() + 6 * mesh.board_of[on_board]
        self.count = np.where(on_board, 6, np.where(free, 3, 0)).astype(np.int32)
        self.size = int(3 * free.sum() + 6 * boards)
        gradients, volumes = mesh.gradients
        blocks = (material.in_lanes(gradients.transpose(0, 1, 3, 2)), material.in_lanes(volumes))
        self._solid = (*blocks, self.material.shear_mpa, self.material.bulk_mpa)
        self._free = np.flatnonzero(free)
        self._springs = mesh.springs[self._free].ravel()
        self._members = [np.flatnonzero(mesh.board_of == n) for n in range(boards)]
        self._motion = np.zeros((len(mesh.nodes), 3, 6))  # the boards' B
        self._areas = mesh.face_areas / loads.POINTS**2
        self._make_pattern()

    def rest(self) -> State:
        """The flat skin as cast."""
        return State(np.zeros(self.size), np.tile(np.eye(3), (len(self.mesh.centres), 1, 1)))

    def places(self, state: State) -> np.ndarray:
        """(nodes, 3) mm: where the nodes are."""
        places = self.mesh.nodes.copy()
        places[self._free] += state.unknowns[: 3 * len(self._free)].reshape(-1, 3)
        for n, (d, w) in enumerate(self.boards(state.unknowns)):
            own, centre = self._members[n], self.mesh.centres[n]
            turned = rotation(w) @ state.rotations[n]
            places[own] = centre + d + (self.mesh.nodes[own] - centre) @ turned.T
        return places

    def boards(self, unknowns: np.ndarray) -> np.ndarray:
        """A view (boards, 2, 3) of unknowns (n,): the boards' displacements and rotations."""
        return unknowns[3 * len(self._free) :].reshape(-1, 2, 3)

    def accept(self, state: State) -> State:
        """The same posture with each board's rotation moved out of the unknowns."""
        state = state.copy()
        for n, (_, w) in enumerate(self.boards(state.unknowns)):
            state.rotations[n] = rotation(w) @ state.rotations[n]
            w[:] = 0.0
        return state

    def ahead(self, before: State, now: State, share: float) -> State:
        """The accepted posture `now`, moved on by a share of what happened since the accepted one `before`."""
        step = now.unknowns - before.unknowns
        for n, (_, w) in enumerate(self.boards(step)):
            turn = now.rotations[n] @ before.rotations[n].T
            w[:] = (turn[[2, 0, 1], [1, 2, 0]] - turn[[1, 2, 0], [2, 0, 1]]) / 2
        return State(now.unknowns + share * step, now.rotations)

    def residual(
        self, state: State, load: Load, wants_tangent: bool = False
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Out-of-balance force (n,) N (None if an element is inside out), and of the indenter (4,) the
        force on it in N and how deep it sinks into the skin in mm.

        wants_tangent: its upper triangle is then in `pattern`.
        """
        mesh = self.mesh
        places = self.places(state)
        touched = load.centre is not None
        centre = load.centre if load.centre is not None else np.zeros(3)
        before = load.before if load.before is not None else centre
        indenter = (centre, centre - before, self.material.touch_law)
        forces = np.zeros_like(places)
        total = np.zeros(4)
        if wants_tangent:
            self.pattern.data[:] = 0.0
            for n in range(len(mesh.centres)):
                self._motion[self._members[n]] = self._board_motion(n, state, places)
        good = sum_elements(
            mesh.elements,
            places,
            load.old_places if load.old_places is not None else places,
            self._solid,
            (mesh.is_bottom, load.pressure_mpa),
            (mesh.is_top & touched, self._areas, indenter),
            (self.first, self.count, self._motion, self._positions),
            wants_tangent,
            forces,
            self.pattern.data,
            total,
        )
        if not good:
            return None, total
        held = slice(3 * len(self._free))
        residual = np.empty(self.size)
        residual[held] = forces[self._free].ravel() + self._springs * state.unknowns[held]
        if wants_tangent:
            self.pattern.data[self.pattern.indptr[held]] += self._springs
        for n, (d, w) in enumerate(self.boards(state.unknowns)):
            own = self._members[n]
            arms = places[own] - mesh.centres[n] - d
            moment = forces[own].T @ arms  # f r^T
            twist = np.array(
                [moment[2, 1] - moment[1, 2], moment[0, 2] - moment[2, 0], moment[1, 0] - moment[0, 1]]
            )
            self.boards(residual)[n] = forces[own].sum(axis=0), twist @ spin(w)
            if wants_tangent:
                self._add_turning(n, moment)
        return residual, total

    def _board_motion(self, n: int, state: State, places: np.ndarray) -> np.ndarray:
        """B (members, 3, 6) of a board's nodes."""
        d, w = self.boards(state.unknowns)[n]
        arms = places[self._members[n]] - self.mesh.centres[n] - d
        turns = -skew(arms) @ spin(w)
        return np.concatenate([np.broadcast_to(np.eye(3), turns.shape), turns], axis=2)

    def _add_turning(self, n: int, moment: np.ndarray) -> None:
        """Second derivative of exp(w) r against the forces, `moment` = f r^T: (f r^T + r f^T)/2 - (f.r) I, at w = 0."""
        block = (moment + moment.T) / 2 - np.trace(moment) * np.eye(3)
        start = 3 * len(self._free) + 6 * n + 3
        for i in range(3):
            row = self.pattern.indptr[start + i]
            self.pattern.data[row : row + 3 - i] += block[i, i:]

    def _make_pattern(self) -> None:
        """The upper triangle's pattern, of unknowns that share an element; where each element's blocks begin in it."""
        elements, each = self.mesh.elements, np.arange(6)
        first, count = self.first[elements].astype(np.int64), self.count[elements]  # (e, 8)
        element, node, n = np.nonzero(each < count[..., None])
        moves = sparse.csr_matrix(
            (np.ones(len(element)), (element, first[element, node] + n)), (len(elements), self.size)
        )
        self.pattern = sparse.triu(moves.T @ moves, format="csr")
        self.pattern.sort_indices()
        entries = self.pattern.tocoo()
        # A block's row begins at its first column, or at the diagonal in a block on the diagonal. What is not in the
        # triangle is not asked for.
        is_diagonal = first[:, :, None] == first[:, None, :]
        rows = first[:, :, None, None] + each
        begins = first[:, None, :, None] + np.where(is_diagonal[..., None], each, 0)
        keys = entries.row.astype(np.int64) * self.size + entries.col
        self._positions = np.searchsorted(keys, rows * self.size + begins).astype(np.int32)


def rotation(w: np.ndarray) -> np.ndarray:
    """exp of the skew matrix of w (3,) rad, by Rodrigues' formula."""
    angle2 = float(w @ w)
    angle = np.sqrt(angle2)
    sine = np.sinc(angle / np.pi)
    half = np.sinc(angle / (2 * np.pi))
    k = skew(w)
    return np.eye(3) + sine * k + half * half / 2 * k @ k


def spin(w: np.ndarray) -> np.ndarray:
    """T(w) (3, 3): the spin of exp(w) when w changes, I + (1-cos)/a^2 [w] + (a-sin)/a^3 [w]^2."""
    angle2 = float(w @ w)
    angle = np.sqrt(angle2)
    half = np.sinc(angle / (2 * np.pi))
    cubic = (1 - np.sinc(angle / np.pi)) / angle2 if angle2 > 1e-8 else 1 / 6 - angle2 / 120
    k = skew(w)
    return np.eye(3) + half * half / 2 * k + cubic * k @ k


def skew(v: np.ndarray) -> np.ndarray:
    """(..., 3, 3) with skew(v) u = v x u."""
    result = np.zeros((*v.shape, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return result - np.swapaxes(result, -1, -2)

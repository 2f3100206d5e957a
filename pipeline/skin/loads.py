"""What acts on the skin's faces: air from below, the indenter from above.

Air: p N n da on the lower faces, following them. Its tangent is unsymmetric face by face, but the whole has a
potential (pressure times enclosed volume) because the skin's edge is clamped, so the symmetric half is exact. Where
the base gives way the edge moves, and the half leaves an error of the tangent that iterations make up for.

Indenter: a hemisphere with a rod on it, or both swept along an edge, as a penalty at points of the upper faces and
not at their nodes, which would slip between the skin's nodes and pierce it. The traction per reference area is
k gap^2: points come into touch smoothly, and the steeper the deeper, which keeps the rod from sinking into a highly
inflated skin (a law that grows linearly let it sink 2 mm at 2 kPa and then pierce). Friction opposes the
slip per millimetre of the indenter's travel,

    t = -mu p s / sqrt(s^2 + eps^2),     s = tangential part of (dx - dc) / travel

which does not depend on how finely the path is divided. The part of its tangent that is unsymmetric (the
normal force's change) is dropped: as many iterations, half the factorisation's cost.
"""

import math

import numpy as np
from numba import njit

from softslide.pipeline.skin.material import FAST

# Midpoints of a 5 x 5 division of each upper face: at 2.5 mm elements half a millimetre apart, against an
# indenter that touches over 1.7 mm at least.
POINTS = 5
# k, MPa/mm^2; eps: slip per travel at which friction is well developed and below which the skin clings.
STIFFNESS = 0.5
SLIP = 0.15


def _face_shapes() -> np.ndarray:
    """(25, 4) bilinear shape functions of an upper face's nodes at the contact points."""
    ticks = (2 * np.arange(POINTS) + 1) / POINTS - 1
    r, s = (v.ravel() for v in np.meshgrid(ticks, ticks))
    return np.stack([(1 - r) * (1 - s), (1 + r) * (1 - s), (1 + r) * (1 + s), (1 - r) * (1 + s)], axis=-1) / 4


def _pressed_shapes() -> np.ndarray:
    """(4 points, 3, 4 nodes): N, dN/dr, dN/ds of a lower face at 2 x 2 Gauss points, exact for p N n da."""
    signs = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
    points = signs / math.sqrt(3.0)
    along, across = (1 + points[:, None, i] * signs[:, i] for i in range(2))
    return np.stack([along * across, signs[:, 0] * across, signs[:, 1] * along], axis=1) / 4


FACE_SHAPES, PRESSED_SHAPES = _face_shapes(), _pressed_shapes()


@njit(cache=True, fastmath=FAST, error_model="numpy")
def air(l, x, pressure, wants_tangent, force, stiffness):
    """Takes the air's push on an element's lower face (nodes 0..3) from its internal force and tangent.

    Args:
        l: which of the lanes. x: (3, 8, lanes) the nodes' places, mm. pressure: MPa.
        force: (3, 8, lanes) N. stiffness: (8 a, 8 b, 3 i, 3 j, lanes) N/mm, d force_ai / d x_bj.
    """
    r = np.empty(3)
    s = np.empty(3)
    for q in range(4):
        shape = PRESSED_SHAPES[q]
        for i in range(3):
            r[i] = s[i] = 0.0
            for a in range(4):
                r[i] += x[i, a, l] * shape[1, a]
                s[i] += x[i, a, l] * shape[2, a]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            area = pressure * (r[j] * s[k] - r[k] * s[j])
            for a in range(4):
                force[i, a, l] -= area * shape[0, a]
        if wants_tangent:
            for a in range(4):
                for b in range(4):
                    for i in range(3):
                        j, k = (i + 1) % 3, (i + 2) % 3
                        # d area_i / d x_bk and / d x_bj; half here, half transposed: the symmetric part
                        up = 0.5 * pressure * shape[0, a] * (r[j] * shape[2, b] - s[j] * shape[1, b])
                        down = 0.5 * pressure * shape[0, a] * (s[k] * shape[1, b] - r[k] * shape[2, b])
                        stiffness[a, b, i, k, l] -= up
                        stiffness[b, a, k, i, l] -= up
                        stiffness[a, b, i, j, l] -= down
                        stiffness[b, a, j, i, l] -= down


@njit(cache=True, fastmath=FAST, error_model="numpy")
def is_near(nodes, places, indenter):
    """Whether the indenter, as in `touch`, can touch the upper face of an element with these nodes (8,)."""
    centre, _, law = indenter
    near = 1e30
    size = 0.0
    for a in range(4, 8):
        d0, d1 = places[nodes[a], 0] - centre[0], places[nodes[a], 1] - centre[1]
        near = min(near, d0 * d0 + d1 * d1)
        e0, e1 = places[nodes[a], 0] - places[nodes[4], 0], places[nodes[a], 1] - places[nodes[4], 1]
        size = max(size, e0 * e0 + e1 * e1)
    return math.sqrt(near) <= law[0] + math.sqrt(law[4] * law[4] + law[5] * law[5]) + math.sqrt(size)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def touch(l, x, before, area, indenter, wants_tangent, force, stiffness, total):
    """Adds the indenter's contact on an element's upper face (nodes 4..7) to its force and tangent.

    Args:
        l, x, force, stiffness: as in `air`. before: (3, 8) the nodes' places at the last position, mm.
        area: of one point, mm^2.
        indenter: (3,) its hemisphere's centre, or the edge's middle, mm; (3,) how far it moved since the last position,
            mm, without friction where it did not; (6,) radius mm, friction, k MPa/mm^2, eps, half of the edge along x
            and y mm.
        total: (4,) the force on the indenter, N, added to, and the deepest gap so far, mm.
    """
    centre, moved, law = indenter
    travel = math.sqrt(moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2])
    radius, friction, penalty, clinging, half_x, half_y = law
    half_squared = half_x * half_x + half_y * half_y
    point = np.empty(3)
    slip = np.empty(3)
    normal = np.empty(3)
    block = np.empty((3, 3))
    for q in range(len(FACE_SHAPES)):
        shape = FACE_SHAPES[q]
        for i in range(3):
            point[i] = -centre[i]
            for a in range(4):
                point[i] += shape[a] * x[i, 4 + a, l]
        # From the nearest point of the edge's axis; beside it, not at its ends, that point moves along with the skin.
        beside = 0.0
        if half_squared > 0.0:
            share = (point[0] * half_x + point[1] * half_y) / half_squared
            if -1.0 < share < 1.0:
                beside = 1.0 / half_squared
            share = min(max(share, -1.0), 1.0)
            point[0] -= share * half_x
            point[1] -= share * half_y
        round_head = point[2] <= 0.0
        distance = math.sqrt(
            point[0] * point[0] + point[1] * point[1] + (point[2] * point[2] if round_head else 0.0)
        )
        gap = radius - distance
        if gap <= 0.0:
            continue
        total[3] = max(total[3], gap)
        for i in range(3):
            normal[i] = point[i] / distance
        if not round_head:
            normal[2] = 0.0
        traction = area * penalty * gap * gap
        slope = area * penalty * 2.0 * gap

        drag = 0.0  # friction over the regularised slip
        bend = 0.0
        if friction > 0.0 and travel > 0.0:
            along = 0.0
            for i in range(3):
                slip[i] = -moved[i]
                for a in range(4):
                    slip[i] += shape[a] * (x[i, 4 + a, l] - before[i, 4 + a])
                slip[i] /= travel
                along += slip[i] * normal[i]
            squared = clinging * clinging
            for i in range(3):
                slip[i] -= along * normal[i]
                squared += slip[i] * slip[i]
            drag = friction * traction / math.sqrt(squared)
            bend = drag / (travel * squared)
        else:
            slip[:] = 0.0
        for i in range(3):
            pull = -traction * normal[i] + drag * slip[i]
            total[i] += pull
            for a in range(4):
                force[i, 4 + a, l] += shape[a] * pull
        if wants_tangent:
            # d(-t n)/dx = slope n n - t/r (I - n n), the rod's and the edge's axes having no curvature
            curve = traction / distance
            stick = drag / travel if drag > 0.0 else 0.0
            for i in range(3):
                for j in range(3):
                    tangential = (1.0 if i == j else 0.0) - normal[i] * normal[j]
                    curved = tangential if round_head or (i < 2 and j < 2) else 0.0
                    if beside > 0.0 and i < 2 and j < 2:
                        along_edge = (half_x if i == 0 else half_y) * (half_x if j == 0 else half_y)
                        curved -= beside * along_edge
                    block[i, j] = (
                        slope * normal[i] * normal[j]
                        - curve * curved
                        + stick * tangential
                        - bend * slip[i] * slip[j]
                    )
            for a in range(4):
                for b in range(4):
                    both = shape[a] * shape[b]
                    for i in range(3):
                        for j in range(3):
                            stiffness[4 + a, 4 + b, i, j, l] += both * block[i, j]

"""The loop over elements: solid, air and indenter into one force vector and one sparse triangle.

The compiled loop is kept on disk with its callees in it, and only a change of this file renews it: touch it
after an edit of `material` or `loads`.
"""

import numpy as np
from numba import njit

from pipeline.skin import loads, material


@njit(cache=True, fastmath=material.FAST, error_model="numpy")
def sum_elements(
    elements,
    places,
    old_places,
    gradients,
    volumes,
    shear,
    bulk,
    is_bottom,
    pressure,
    pressed_shapes,
    is_top,
    areas,
    centre,
    moved,
    law,
    face_shapes,
    wants_tangent,
    first,
    count,
    motion,
    positions,
    forces,
    data,
    total,
):
    """Adds up forces (nodes, 3) N, the tangent's data in N/mm and the indenter's `total` (4,) as `loads.touch`.

    Args:
        places, old_places: (nodes, 3) mm, now and at the indenter's last position.
        first, count: (nodes,) each node's first unknown and how many it has: 0 clamped, 3 free, 6 on a board.
        motion: (nodes, 3, 6) the boards' B. positions: (e, 8, 8, 6) where each block's rows begin in `data`.

    Returns:
        False if an element is inside out; the sums are void then.
    """
    x = np.empty((3, 8))
    before = np.empty((3, 8))
    room = np.empty((8, 3, 8))
    force = np.empty((3, 8))
    stiffness = np.empty((8, 3, 3, 8))
    carried = np.empty((3, 6))
    travel = np.sqrt(moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2])
    for e in range(elements.shape[0]):
        for a in range(8):
            for i in range(3):
                x[i, a] = places[elements[e, a], i]
        if not material.element(
            x, gradients[e], volumes[e], shear, bulk, wants_tangent, room, force, stiffness
        ):
            return False
        if is_bottom[e] and pressure != 0.0:
            loads.air(x, pressure, pressed_shapes, wants_tangent, force, stiffness)
        if is_top[e]:
            for a in range(8):
                for i in range(3):
                    before[i, a] = old_places[elements[e, a], i]
            loads.touch(
                x,
                before,
                areas[e],
                centre,
                moved,
                travel,
                law,
                face_shapes,
                wants_tangent,
                force,
                stiffness,
                total,
            )
        for a in range(8):
            for i in range(3):
                forces[elements[e, a], i] += force[i, a]
        if not wants_tangent:
            continue
        for a in range(8):
            na = elements[e, a]
            if count[na] == 0:
                continue
            for b in range(8):
                nb = elements[e, b]
                if count[nb] == 0 or first[nb] < first[na]:
                    continue
                same = first[na] == first[nb]
                # K_ab B_b, then B_a^T of it
                if count[nb] == 3:
                    for i in range(3):
                        for j in range(3):
                            carried[i, j] = stiffness[a, i, j, b]
                else:
                    for i in range(3):
                        for j in range(6):
                            carried[i, j] = 0.0
                            for k in range(3):
                                carried[i, j] += stiffness[a, i, k, b] * motion[nb, k, j]
                for i in range(count[na]):
                    at = positions[e, a, b, i]
                    begin = i if same else 0
                    for j in range(begin, count[nb]):
                        if count[na] == 3:
                            value = carried[i, j]
                        else:
                            value = 0.0
                            for k in range(3):
                                value += motion[na, k, i] * carried[k, j]
                        data[at + j - begin] += value
    return True

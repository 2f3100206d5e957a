"""The loop over elements: solid, air and indenter into one force vector and one sparse triangle.

The compiled loop is kept on disk with its callees in it, and only a change of this file renews it: touch it
after an edit of `material` or `loads`.
"""

import numpy as np
from numba import njit

from softslide.pipeline.skin import loads, material


@njit(cache=True, fastmath=material.FAST, error_model="numpy")
def sum_elements(
    elements, places, old_places, solid, air, indenter, layout, wants_tangent, forces, data, total
):
    """Adds up forces (nodes, 3) N, the tangent's data in N/mm and the indenter's `total` (4,) as `loads.touch`.

    Args:
        places, old_places: (nodes, 3) mm, now and at the indenter's last position.
        solid: gradients and volumes of each block of elements, G and K, as `material.forces`.
        air: (e,) bool: the elements that it presses, and its pressure, MPa.
        indenter: (e,) bool: the elements that it may touch, (e,) areas, and what `loads.touch` calls so.
        layout: (nodes,) each node's first unknown and how many it has: 0 clamped, 3 free, 6 on a board;
            (nodes, 3, 6) the boards' B; (e, 8, 8, 6) where each block's rows begin in `data`.

    Returns:
        False if an element is inside out; the sums are void then.
    """
    gradients, volumes, shear, bulk = solid
    is_pressed, pressure = air
    may_touch, areas, touching = indenter
    x = np.empty(material.NODAL)
    force = np.empty(material.NODAL)
    room = np.empty(material.ROOM)
    slopes = np.empty(material.SLOPES)
    swelling = np.empty(material.NODAL)
    stiffness = np.empty(64 * 9 * material.LANES)
    nodal_x = x.reshape(3, 8, material.LANES)
    nodal_force = force.reshape(3, 8, material.LANES)
    nodal_stiffness = stiffness.reshape(8, 8, 3, 3, material.LANES)
    before = np.empty((3, 8))
    for block in range(len(gradients)):
        begin = block * material.LANES
        lanes = min(material.LANES, len(elements) - begin)
        for l in range(material.LANES):
            e = min(begin + l, len(elements) - 1)
            for a in range(8):
                for i in range(3):
                    nodal_x[i, a, l] = places[elements[e, a], i]
        if not material.forces(x, gradients[block], volumes[block], shear, bulk, room, force):
            return False
        if wants_tangent:
            material.tangent(gradients[block], volumes[block], shear, room, slopes, swelling, stiffness)
        for l in range(lanes):
            e = begin + l
            if is_pressed[e] and pressure != 0.0:
                loads.air(l, nodal_x, pressure, wants_tangent, nodal_force, nodal_stiffness)
            if may_touch[e] and loads.is_near(elements[e], places, touching):
                for a in range(8):
                    for i in range(3):
                        before[i, a] = old_places[elements[e, a], i]
                loads.touch(
                    l, nodal_x, before, areas[e], touching, wants_tangent, nodal_force, nodal_stiffness, total
                )
            for a in range(8):
                for i in range(3):
                    forces[elements[e, a], i] += nodal_force[i, a, l]
            if wants_tangent:
                add_tangent(e, l, elements, nodal_stiffness, layout, data)
    return True


@njit(cache=True, fastmath=material.FAST, error_model="numpy")
def add_tangent(e, l, elements, stiffness, layout, data):
    """Adds the tangent of element e, which lies in lane l of a block's, to `data`.

    Args:
        stiffness: (8 a, 8 b, 3 i, 3 j, lanes) N/mm, read where b >= a. The rest: as `sum_elements`.
    """
    first, count, motion, positions = layout
    block = np.empty((3, 3))
    carried = np.empty((3, 6))
    for a in range(8):
        na = elements[e, a]
        if count[na] == 0:
            continue
        for b in range(8):
            nb = elements[e, b]
            if count[nb] == 0 or first[nb] < first[na]:
                continue
            same = first[na] == first[nb]
            for i in range(3):
                for j in range(3):
                    block[i, j] = stiffness[a, b, i, j, l] if b >= a else stiffness[b, a, j, i, l]
            if count[na] == 3 and count[nb] == 3:
                for i in range(3):
                    begin = i if same else 0
                    at = positions[e, a, b, i] - begin
                    for j in range(begin, 3):
                        data[at + j] += block[i, j]
                continue
            # K_ab B_b, then B_a^T of it
            if count[nb] == 3:
                carried[:, :3] = block
            else:
                for i in range(3):
                    for j in range(6):
                        carried[i, j] = 0.0
                        for k in range(3):
                            carried[i, j] += block[i, k] * motion[nb, k, j]
            for i in range(count[na]):
                begin = i if same else 0
                at = positions[e, a, b, i] - begin
                for j in range(begin, count[nb]):
                    if count[na] == 3:
                        value = carried[i, j]
                    else:
                        value = 0.0
                        for k in range(3):
                            value += motion[na, k, i] * carried[k, j]
                    data[at + j] += value

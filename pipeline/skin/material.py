"""Nearly incompressible neo-Hookean solid in hexahedra with one dilatation each (mean dilatation).

    W = G/2 (J^(-2/3) tr C - 3) + K/2 (theta - 1)^2,     theta = v / V of the element

so that the pressure p = K (theta - 1) is constant in an element and does not lock (Simo, Taylor, Pister 1985,
10.1016/0045-7825(85)90033-7). The tangent is that of the spatial description (Bonet and Wood, Nonlinear
Continuum Mechanics for Finite Element Analysis, sections 6.4 and 8.6).
"""

import numpy as np
from numba import njit

# Reassociation lets the compiler vectorise. NaN and infinity keep their meaning: an inverted element must be seen.
FAST = {"contract", "reassoc", "arcp", "nsz"}

# So many elements go through side by side, one in each lane: the last axis of every array here. The arrays are
# flat, for only offsets that are known when compiling let the loops over lanes become vector instructions.
LANES = 16
NODAL = 3 * 8 * LANES  # a vector at each of eight nodes
POINT = 10 * LANES  # a deformation gradient and its determinant
ROOM = 8 * POINT + 2 * LANES
SLOPES = 2 * NODAL + 22 * LANES


def in_lanes(values: np.ndarray) -> np.ndarray:
    """(elements, ...) as (blocks, ... * LANES), the last element repeated to fill the last block."""
    blocks = -(-len(values) // LANES)
    filled = values[np.minimum(np.arange(blocks * LANES), len(values) - 1)]
    return np.ascontiguousarray(np.moveaxis(filled.reshape(blocks, LANES, -1), 1, 2)).reshape(blocks, -1)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def forces(x, gradients, volumes, shear, bulk, room, force):
    """Internal forces of a block of elements.

    Args:
        x: (3, 8 nodes, LANES) flat, mm. gradients: (8 points, 3, 8 nodes, LANES) flat, 1/mm.
        volumes: (8, LANES) flat, mm^3. shear, bulk: moduli G and K, MPa.
        room: (ROOM,) scratch: the deformation gradients and pressures, which `tangent` goes on from.
        force: (3, 8, LANES) flat, N, overwritten.

    Returns:
        Whether all elements are right side out; when not, the results are void.
    """
    row = 8 * LANES
    pressures = 8 * POINT
    for n in range(NODAL):
        force[n] = 0.0
    for q in range(8):
        at, to = q * NODAL, q * POINT
        for l in range(LANES):
            f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
            for a in range(8):
                n = a * LANES + l
                x0, x1, x2 = x[n], x[row + n], x[2 * row + n]
                g0, g1, g2 = gradients[at + n], gradients[at + row + n], gradients[at + 2 * row + n]
                f00 += x0 * g0
                f01 += x0 * g1
                f02 += x0 * g2
                f10 += x1 * g0
                f11 += x1 * g1
                f12 += x1 * g2
                f20 += x2 * g0
                f21 += x2 * g1
                f22 += x2 * g2
            room[to + l] = f00
            room[to + LANES + l] = f01
            room[to + 2 * LANES + l] = f02
            room[to + 3 * LANES + l] = f10
            room[to + 4 * LANES + l] = f11
            room[to + 5 * LANES + l] = f12
            room[to + 6 * LANES + l] = f20
            room[to + 7 * LANES + l] = f21
            room[to + 8 * LANES + l] = f22
            room[to + 9 * LANES + l] = (
                f00 * (f11 * f22 - f12 * f21) + f01 * (f12 * f20 - f10 * f22) + f02 * (f10 * f21 - f11 * f20)
            )
    for l in range(LANES):
        volume = now = 0.0
        for q in range(8):
            j = room[q * POINT + 9 * LANES + l]
            if not j > 0.0:
                return False
            volume += volumes[q * LANES + l]
            now += volumes[q * LANES + l] * j
        room[pressures + l] = bulk * (now / volume - 1.0)
        room[pressures + LANES + l] = bulk / volume
    for q in range(8):
        at, to = q * NODAL, q * POINT
        for l in range(LANES):
            f00, f01, f02 = room[to + l], room[to + LANES + l], room[to + 2 * LANES + l]
            f10, f11, f12 = room[to + 3 * LANES + l], room[to + 4 * LANES + l], room[to + 5 * LANES + l]
            f20, f21, f22 = room[to + 6 * LANES + l], room[to + 7 * LANES + l], room[to + 8 * LANES + l]
            j = room[to + 9 * LANES + l]
            weight = volumes[q * LANES + l]
            scale = weight * shear * inverse_cube_root(j) ** 2
            squares = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12
            squares += f20 * f20 + f21 * f21 + f22 * f22
            # First Piola stress: G J^(-2/3) (F - tr C / 3 F^-T) + p J F^-T, with J F^-T = cof F
            c = weight * room[pressures + l] - scale * squares / (3.0 * j)
            p00 = scale * f00 + c * (f11 * f22 - f12 * f21)
            p01 = scale * f01 + c * (f12 * f20 - f10 * f22)
            p02 = scale * f02 + c * (f10 * f21 - f11 * f20)
            p10 = scale * f10 + c * (f02 * f21 - f01 * f22)
            p11 = scale * f11 + c * (f00 * f22 - f02 * f20)
            p12 = scale * f12 + c * (f01 * f20 - f00 * f21)
            p20 = scale * f20 + c * (f01 * f12 - f02 * f11)
            p21 = scale * f21 + c * (f02 * f10 - f00 * f12)
            p22 = scale * f22 + c * (f00 * f11 - f01 * f10)
            for a in range(8):
                n = a * LANES + l
                g0, g1, g2 = gradients[at + n], gradients[at + row + n], gradients[at + 2 * row + n]
                force[n] += p00 * g0 + p01 * g1 + p02 * g2
                force[row + n] += p10 * g0 + p11 * g1 + p12 * g2
                force[2 * row + n] += p20 * g0 + p21 * g1 + p22 * g2
    return True


@njit(cache=True, fastmath=FAST, error_model="numpy")
def tangent(gradients, volumes, shear, room, slopes, swelling, stiffness):
    """The tangent of the block whose `forces` were computed last.

    Args:
        gradients, volumes, shear, room: as handed to `forces`.
        slopes: (SLOPES,) scratch, one point's. swelling: (NODAL,) scratch, dv / dx.
        stiffness: (8 a, 8 b, 3 i, 3 j, LANES) flat, N/mm, d force_ai / d x_bj, overwritten where b >= a.
    """
    row = 8 * LANES
    pull = NODAL  # weight G J^(-2/3) dev(F F^T) F^-T grad N, after F^-T grad N
    inverse = 2 * NODAL  # F^-T, then G J^(-2/3) dev(F F^T) F^-T, weighted
    halves = inverse + 18 * LANES
    straights, crosses, swells = halves + LANES, halves + 2 * LANES, halves + 3 * LANES
    pressures, bulks = 8 * POINT, 8 * POINT + LANES
    for n in range(64 * 9 * LANES):
        stiffness[n] = 0.0
    for n in range(NODAL):
        swelling[n] = 0.0
    for q in range(8):
        at, to = q * NODAL, q * POINT
        for l in range(LANES):
            f00, f01, f02 = room[to + l], room[to + LANES + l], room[to + 2 * LANES + l]
            f10, f11, f12 = room[to + 3 * LANES + l], room[to + 4 * LANES + l], room[to + 5 * LANES + l]
            f20, f21, f22 = room[to + 6 * LANES + l], room[to + 7 * LANES + l], room[to + 8 * LANES + l]
            j = room[to + 9 * LANES + l]
            weight = volumes[q * LANES + l]
            scale = weight * shear * inverse_cube_root(j) ** 2
            squares = f00 * f00 + f01 * f01 + f02 * f02 + f10 * f10 + f11 * f11 + f12 * f12
            squares += f20 * f20 + f21 * f21 + f22 * f22
            half, pi = scale * squares / 3.0, weight * j * room[pressures + l]
            slopes[halves + l] = half
            slopes[straights + l] = pi - 2.0 / 3.0 * half
            slopes[crosses + l] = half - pi
            slopes[swells + l] = weight * j
            c00 = (f11 * f22 - f12 * f21) / j
            c01 = (f12 * f20 - f10 * f22) / j
            c02 = (f10 * f21 - f11 * f20) / j
            c10 = (f02 * f21 - f01 * f22) / j
            c11 = (f00 * f22 - f02 * f20) / j
            c12 = (f01 * f20 - f00 * f21) / j
            c20 = (f01 * f12 - f02 * f11) / j
            c21 = (f02 * f10 - f00 * f12) / j
            c22 = (f00 * f11 - f01 * f10) / j
            slopes[inverse + l] = c00
            slopes[inverse + LANES + l] = c01
            slopes[inverse + 2 * LANES + l] = c02
            slopes[inverse + 3 * LANES + l] = c10
            slopes[inverse + 4 * LANES + l] = c11
            slopes[inverse + 5 * LANES + l] = c12
            slopes[inverse + 6 * LANES + l] = c20
            slopes[inverse + 7 * LANES + l] = c21
            slopes[inverse + 8 * LANES + l] = c22
            slopes[inverse + 9 * LANES + l] = scale * f00 - half * c00
            slopes[inverse + 10 * LANES + l] = scale * f01 - half * c01
            slopes[inverse + 11 * LANES + l] = scale * f02 - half * c02
            slopes[inverse + 12 * LANES + l] = scale * f10 - half * c10
            slopes[inverse + 13 * LANES + l] = scale * f11 - half * c11
            slopes[inverse + 14 * LANES + l] = scale * f12 - half * c12
            slopes[inverse + 15 * LANES + l] = scale * f20 - half * c20
            slopes[inverse + 16 * LANES + l] = scale * f21 - half * c21
            slopes[inverse + 17 * LANES + l] = scale * f22 - half * c22
        for a in range(8):
            for i in range(3):
                of, to = inverse + 3 * i * LANES, (8 * i + a) * LANES
                for l in range(LANES):
                    n = a * LANES + l
                    g0, g1, g2 = gradients[at + n], gradients[at + row + n], gradients[at + 2 * row + n]
                    c0, c1, c2 = slopes[of + l], slopes[of + LANES + l], slopes[of + 2 * LANES + l]
                    d0, d1, d2 = (
                        slopes[of + 9 * LANES + l],
                        slopes[of + 10 * LANES + l],
                        slopes[of + 11 * LANES + l],
                    )
                    s = c0 * g0 + c1 * g1 + c2 * g2
                    slopes[to + l] = s
                    slopes[pull + to + l] = d0 * g0 + d1 * g1 + d2 * g2
                    swelling[to + l] += slopes[swells + l] * s
        for a in range(8):
            for b in range(a, 8):
                to = (a * 8 + b) * 9 * LANES
                for l in range(LANES):
                    na, nb = a * LANES + l, b * LANES + l
                    half, straight, cross = slopes[halves + l], slopes[straights + l], slopes[crosses + l]
                    s0, s1, s2 = slopes[na], slopes[row + na], slopes[2 * row + na]
                    t0, t1, t2 = slopes[nb], slopes[row + nb], slopes[2 * row + nb]
                    d0, d1, d2 = slopes[pull + na], slopes[pull + row + na], slopes[pull + 2 * row + na]
                    e0 = 2.0 / 3.0 * slopes[pull + nb]
                    e1 = 2.0 / 3.0 * slopes[pull + row + nb]
                    e2 = 2.0 / 3.0 * slopes[pull + 2 * row + nb]
                    along = (d0 + half * s0) * t0 + (d1 + half * s1) * t1 + (d2 + half * s2) * t2
                    m0 = straight * s0 - 2.0 / 3.0 * d0
                    m1 = straight * s1 - 2.0 / 3.0 * d1
                    m2 = straight * s2 - 2.0 / 3.0 * d2
                    r0, r1, r2 = cross * t0, cross * t1, cross * t2
                    stiffness[to + l] += along + r0 * s0 + m0 * t0 - s0 * e0
                    stiffness[to + LANES + l] += r0 * s1 + m0 * t1 - s0 * e1
                    stiffness[to + 2 * LANES + l] += r0 * s2 + m0 * t2 - s0 * e2
                    stiffness[to + 3 * LANES + l] += r1 * s0 + m1 * t0 - s1 * e0
                    stiffness[to + 4 * LANES + l] += along + r1 * s1 + m1 * t1 - s1 * e1
                    stiffness[to + 5 * LANES + l] += r1 * s2 + m1 * t2 - s1 * e2
                    stiffness[to + 6 * LANES + l] += r2 * s0 + m2 * t0 - s2 * e0
                    stiffness[to + 7 * LANES + l] += r2 * s1 + m2 * t1 - s2 * e1
                    stiffness[to + 8 * LANES + l] += along + r2 * s2 + m2 * t2 - s2 * e2
    for a in range(8):
        for b in range(a, 8):
            for i in range(3):
                for j3 in range(3):
                    to = ((a * 8 + b) * 9 + i * 3 + j3) * LANES
                    for l in range(LANES):
                        stiffness[to + l] += (
                            room[bulks + l]
                            * swelling[(i * 8 + a) * LANES + l]
                            * swelling[(j3 * 8 + b) * LANES + l]
                        )


@njit(cache=True, fastmath=FAST, error_model="numpy", inline="always")
def inverse_cube_root(j):
    """j^(-1/3) to 1e-12 for 0.02 < j < 20, by the third-order expansion of t^(-1/3) about t = j y^3 = 1.

    Iterated from below; a library call would end vectorisation.
    """
    y = 3.0 / (2.0 + j)
    for _ in range(6):
        t = j * y * y * y
        y *= (14.0 - 7.0 * t + 2.0 * t * t) / 9.0
    return y

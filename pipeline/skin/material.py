"""Nearly incompressible neo-Hookean solid in hexahedra with one dilatation each (mean dilatation).

    W = G/2 (J^(-2/3) tr C - 3) + K/2 (theta - 1)^2,     theta = v / V of the element

so that the pressure p = K (theta - 1) is constant in an element and does not lock (Simo, Taylor, Pister 1985,
10.1016/0045-7825(85)90033-7). Stress and tangent are those of the spatial description (Bonet and Wood,
Nonlinear Continuum Mechanics for Finite Element Analysis, sections 6.4 and 8.6).
"""

import math

import numpy as np
from numba import njit

# Reassociation lets the compiler vectorise over an element's eight nodes, which is why they are the last
# axis of every array here. NaN and infinity keep their meaning: an inverted element must be seen.
FAST = {"contract", "reassoc", "arcp", "nsz"}


@njit(cache=True, fastmath=FAST, error_model="numpy")
def element(x, gradients, volumes, shear, bulk, wants_tangent, room, force, stiffness):
    """Internal force of one element and, where asked, its tangent.

    Args:
        x: (3, 8) the nodes' places, mm. gradients: (8 points, 3, 8 nodes) 1/mm. volumes: (8,) mm^3.
        shear, bulk: moduli G and K, MPa.
        room: (8, 3, 8) + scratch for the spatial gradients at each point.
        force: (3, 8) N, overwritten.
        stiffness: (8 a, 3 i, 3 j, 8 b) N/mm, d force_ai / d x_bj, overwritten where asked.

    Returns:
        Whether the element is right side out; when not, the results are void.
    """
    jacobian = np.empty(8)
    left = np.empty((8, 6))
    volume = 0.0
    now = 0.0
    force[:] = 0.0
    for q in range(8):
        g = gradients[q]
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        for a in range(8):
            f00 += x[0, a] * g[0, a]
            f01 += x[0, a] * g[1, a]
            f02 += x[0, a] * g[2, a]
            f10 += x[1, a] * g[0, a]
            f11 += x[1, a] * g[1, a]
            f12 += x[1, a] * g[2, a]
            f20 += x[2, a] * g[0, a]
            f21 += x[2, a] * g[1, a]
            f22 += x[2, a] * g[2, a]
        c00 = f11 * f22 - f12 * f21
        c01 = f12 * f20 - f10 * f22
        c02 = f10 * f21 - f11 * f20
        j = f00 * c00 + f01 * c01 + f02 * c02
        if not j > 0.0:
            return False
        jacobian[q] = j
        volume += volumes[q]
        now += volumes[q] * j
        c10 = f02 * f21 - f01 * f22
        c11 = f00 * f22 - f02 * f20
        c12 = f01 * f20 - f00 * f21
        c20 = f01 * f12 - f02 * f11
        c21 = f02 * f10 - f00 * f12
        c22 = f00 * f11 - f01 * f10
        i = 1.0 / j
        s = room[q]
        for a in range(8):  # F^-T grad N = cof F grad N / J
            s[0, a] = (c00 * g[0, a] + c01 * g[1, a] + c02 * g[2, a]) * i
            s[1, a] = (c10 * g[0, a] + c11 * g[1, a] + c12 * g[2, a]) * i
            s[2, a] = (c20 * g[0, a] + c21 * g[1, a] + c22 * g[2, a]) * i
        b = left[q]
        b[0] = f00 * f00 + f01 * f01 + f02 * f02
        b[1] = f10 * f10 + f11 * f11 + f12 * f12
        b[2] = f20 * f20 + f21 * f21 + f22 * f22
        b[3] = f00 * f10 + f01 * f11 + f02 * f12
        b[4] = f00 * f20 + f01 * f21 + f02 * f22
        b[5] = f10 * f20 + f11 * f21 + f12 * f22

    pressure = bulk * (now / volume - 1.0)
    swelling = np.zeros((3, 8))  # dv / dx
    pull = np.empty((3, 8))  # tau' grad N
    if wants_tangent:
        stiffness[:] = 0.0
    for q in range(8):
        s = room[q]
        b = left[q]
        j = jacobian[q]
        scale = volumes[q] * shear * math.exp(-2.0 / 3.0 * math.log(j))
        trace = b[0] + b[1] + b[2]
        t0 = scale * (b[0] - trace / 3.0)
        t1 = scale * (b[1] - trace / 3.0)
        t2 = scale * (b[2] - trace / 3.0)
        t3 = scale * b[3]
        t4 = scale * b[4]
        t5 = scale * b[5]
        wj = volumes[q] * j
        for a in range(8):
            pull[0, a] = t0 * s[0, a] + t3 * s[1, a] + t4 * s[2, a]
            pull[1, a] = t3 * s[0, a] + t1 * s[1, a] + t5 * s[2, a]
            pull[2, a] = t4 * s[0, a] + t5 * s[1, a] + t2 * s[2, a]
        for i in range(3):
            for a in range(8):
                swelling[i, a] += wj * s[i, a]
                force[i, a] += pull[i, a]
        if not wants_tangent:
            continue
        alpha = 2.0 / 3.0 * scale * trace
        pi = pressure * wj
        half, third, cross = alpha / 2.0, pi - alpha / 3.0, alpha / 2.0 - pi
        for a in range(8):
            s0, s1, s2 = s[0, a], s[1, a], s[2, a]
            d0 = pull[0, a] + half * s0
            d1 = pull[1, a] + half * s1
            d2 = pull[2, a] + half * s2
            for i in range(3):
                si = s[i, a]
                along = third * si - 2.0 / 3.0 * pull[i, a]
                for j3 in range(3):
                    row = stiffness[a, i, j3]
                    turned = cross * s[j3, a]
                    for n in range(8):
                        row[n] += turned * s[i, n] + along * s[j3, n] - 2.0 / 3.0 * si * pull[j3, n]
                row = stiffness[a, i, i]
                for n in range(8):
                    row[n] += d0 * s[0, n] + d1 * s[1, n] + d2 * s[2, n]
    for i in range(3):
        for a in range(8):
            force[i, a] += pressure * swelling[i, a]
    if wants_tangent:
        for a in range(8):
            for i in range(3):
                push = bulk / volume * swelling[i, a]
                for j3 in range(3):
                    for n in range(8):
                        stiffness[a, i, j3, n] += push * swelling[j3, n]
    return True

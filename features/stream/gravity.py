"""Whether an output is a tilt: gravity is 1 g long, so that V_z follows from V_x and V_y.

Whatever touches the skin tilts its accelerometers. What moves the device to and fro, or comes in on the wires, changes
V_x and V_y alone, or V_z by more than a tilt can. With the output s at rest and s + d now, both in g, the tilt keeps
    a + b = 0,   a = s_x d_x + s_y d_y + (d_x^2 + d_y^2) / 2,   b = s_z d_z + d_z^2 / 2.
Rubbing shakes the board: what a + b scatters by from block to block is no change of gravity's length.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from softslide.features.stream.conditioning import Conditioning
from softslide.features.stream.drift import nominal_outputs

# Memory of the sums, s: longer than a contact takes over an accelerometer, shorter than the pressure's drift.
MEMORY_S = 8.0
# V_z swings with the pressure, about once in 5 s on the emulated benches: values nearer in time than this are one.
INDEPENDENT_S = 1.0
# Logarithm of the odds from which V_z is said not to follow, and the length's change in standard deviations.
# No slide, recorded or synthetic, comes beyond 1.5 and 1.2 (experiments/LOG.md).
MOST_AGAINST = 3.0
MOST_CHANGE_SD = 4.0
# The length's change, g, within a fifth of a second: means of so many blocks, so many apart. Calibration slides of two
# benches come to 0.008, with 1 % less supply midway to 0.022 and more (experiments/LOG.md). A zero that is off by two
# ZERO_SD_G adds that share of what d_x and d_y change by.
JUMP_G = 0.018
JUMP_MEAN, JUMP_APART = 10, 15
# A jump is beyond that by so many standard deviations of two such means' difference, where the length scatters.
JUMP_SD = 4.0
# Zeros of V_x and V_y drift after the calibration: by so much, g, a takes another share of d (40 mV of 0.8 V/g).
ZERO_SD_G = 0.05


class GravityWatch:
    """One stream's. accelerometers: as in the card; the volts that it is given are scaled, as `conditioning` says."""

    def __init__(self, accelerometers: Sequence[Mapping[str, Any]], conditioning: Conditioning) -> None:
        self._sd_g = conditioning.gravity_sd_g
        self._memory = 1.0 - conditioning.block_s / MEMORY_S
        self._independent = conditioning.block_s / INDEPENDENT_S
        self._nominal = nominal_outputs(accelerometers, conditioning.scale)
        self.begin()

    def begin(self) -> None:
        """A contact begins."""
        # Of each accelerometer: the sums of 1, a, b, a^2, a b, b^2, d_x^2 + d_y^2 and a sixth of (a + b)'s second
        # differences squared: the variance of white scatter, of which waves up to 6 Hz have less than a sixteenth.
        self._sums = [[0.0] * 8 for _ in self._nominal]
        self._lengths = [
            deque[tuple[float, float, float]](maxlen=JUMP_APART + JUMP_MEAN) for _ in self._nominal
        ]
        self._jumped = False

    def push(self, static_v: np.ndarray, subtracted_v: np.ndarray, usable: np.ndarray) -> None:
        """One block of a contact: (C,) V at rest, (C,) V less that, and the accelerometers (A,) in use."""
        static, change, used = static_v.tolist(), subtracted_v.tolist(), usable.tolist()
        for n, nominal in enumerate(self._nominal):
            if nominal is None or not used[n]:
                continue
            zero, sensitivity = nominal
            x, y, z = ((v - zero) / sensitivity for v in static[3 * n : 3 * n + 3])
            dx, dy, dz = (v / sensitivity for v in change[3 * n : 3 * n + 3])
            square = dx * dx + dy * dy
            a, b = x * dx + y * dy + 0.5 * square, z * dz + 0.5 * dz * dz
            lengths = self._lengths[n]
            bend = a + b - 2.0 * lengths[-1][0] + lengths[-2][0] if len(lengths) > 1 else 0.0
            new = (1.0, a, b, a * a, a * b, b * b, square, bend**2 / 6.0)
            sums = [self._memory * old + value for old, value in zip(self._sums[n], new, strict=True)]
            lengths.append((a + b, dx, dy))
            self._sums[n] = sums
            self._jumped = self._jumped or _jumps(lengths, sums[7] / sums[0])

    @property
    def against_g2(self) -> float:
        """How much better V_z is explained by keeping to itself than by following V_x and V_y: independent values times
        difference of variance, g^2, summed over the accelerometers.

        Both are judged about their means, since the static V_z may be off by the pressure's swing.
        """
        total = 0.0
        for weight, a, b, aa, ab, *_ in self._sums:
            if weight > 0.0:
                total += self._independent * (aa + 2.0 * ab - a * (a + 2.0 * b) / weight)
        return total

    @property
    def change_g(self) -> float:
        """Root mean square change of gravity's length since rest, g: the largest of the accelerometers."""
        squares = [
            (aa + 2.0 * ab + bb) / weight for weight, _, _, aa, ab, bb, *_ in self._sums if weight > 0.0
        ]
        return math.sqrt(max(0.0, max(squares, default=0.0)))

    @property
    def kept(self) -> bool:
        """Whether gravity keeps its length, as far as it is known."""
        known = [sums for sums in self._sums if sums[0] > 0.0]
        largest, scatter = (max((sums[n] / sums[0] for sums in known), default=0.0) for n in (6, 7))
        variance = self._sd_g**2 + ZERO_SD_G**2 * largest
        return (
            not self._jumped
            and self.against_g2 <= MOST_AGAINST * 2.0 * variance
            and self.change_g**2 - scatter <= MOST_CHANGE_SD**2 * variance
        )


def _jumps(blocks: deque[tuple[float, float, float]], scatter_g2: float) -> bool:
    """Whether gravity's length changes by more at once than a contact's does. blocks: its change, d_x and d_y, g;
    scatter_g2: the change's variance from block to block."""
    if len(blocks) < JUMP_APART + JUMP_MEAN:
        return False
    after, before = (
        [sum(values) / JUMP_MEAN for values in zip(*islice(blocks, begin, begin + JUMP_MEAN), strict=True)]
        for begin in (JUMP_APART, 0)
    )
    length, dx, dy = (new - old for new, old in zip(after, before, strict=True))
    scattered_g = JUMP_SD * math.sqrt(2.0 * scatter_g2 / JUMP_MEAN)
    return abs(length) > JUMP_G + 2.0 * ZERO_SD_G * math.hypot(dx, dy) + scattered_g

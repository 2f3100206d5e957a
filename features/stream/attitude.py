"""Whether gravity shows the sensor in the attitude in which it was calibrated.

A map is of outputs in the calibration's attitude: turned by an angle b, a touch changes V_x and V_y by the cosine of b
of what it did, and V_z answers too.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from softslide.features.stream.drift import nominal_outputs

# Chosen on a synthetic sensor, its slides turned by calculation (experiments/LOG.md): at 8 degrees 50 to 83 % of the
# intervals hold, at 12 degrees 36 to 64 %. A skin over several heights turns its board as well.
MOST_TURN_DEG = 7.0
MOST_TURN_OF_HEIGHTS_DEG = 15.0
# From this share of the limit on, 4 degrees, an output is believed to be the static one once it has rested for so many
# blocks, 6 s: a stream that begins on a slow contact shows one that is 2 to 6 degrees off (experiments/LOG.md).
UNPROVEN_SHARE, PROVEN_BLOCKS = 4.0 / 7.0, 300
# A contact turns gravity and keeps its length, g, but for gains and zeros; zeros that have drifted alike change it.
KEPT_G = 0.03
# To the z axis, where the static output of the calibration is not known: skins turn a board by up to 20 degrees.
MOST_FROM_Z_DEG = 40.0
# Outputs that show less of gravity, as of a sensor that is read without its direct part, show no attitude.
LEAST_G = 0.5


class Attitude:
    """Of one sensor. accelerometers: as in the card. static_v: (C,) V, scaled, the calibration's static output; empty:
    not known. scale: as in `Conditioning`. heights: whether the calibration has several heights of the skin."""

    def __init__(
        self,
        accelerometers: Sequence[Mapping[str, Any]],
        static_v: Sequence[float],
        scale: float,
        heights: bool = False,
    ) -> None:
        self._nominal = nominal_outputs(accelerometers, scale)
        turn_deg = MOST_TURN_OF_HEIGHTS_DEG if heights else MOST_TURN_DEG
        self._most_deg = turn_deg if static_v else MOST_FROM_Z_DEG
        self._calibrated = [
            self._gravity(static_v, n) if static_v else (0.0, 0.0, 1.0) for n in range(len(self._nominal))
        ]

    def is_other(self, static_v: np.ndarray, usable: np.ndarray) -> bool:
        """Whether any of the accelerometers in use (A,) is turned too far. static_v: (C,) V, scaled, at rest."""
        return any(turn_deg > self._most_deg for _, turn_deg, _ in self._turned(static_v, usable))

    def may_be_touched(self, static_v: np.ndarray, usable: np.ndarray, rested_blocks: np.ndarray) -> bool:
        """Whether one is turned as far as by a contact, at rest for so few blocks (A,) that it may be one."""
        return any(
            kept and turn_deg > UNPROVEN_SHARE * self._most_deg and rested_blocks[n] < PROVEN_BLOCKS
            for n, turn_deg, kept in self._turned(static_v, usable)
        )

    def _turned(self, static_v: np.ndarray, usable: np.ndarray) -> Iterator[tuple[int, float, bool]]:
        """Of each accelerometer in use: its number, its turn since the calibration, deg, whether gravity kept its
        length."""
        static = static_v.tolist()
        for n, nominal in enumerate(self._nominal):
            if nominal is not None and usable[n]:
                gravity, calibrated = self._gravity(static, n), self._calibrated[n]
                kept = abs(math.hypot(*gravity) - math.hypot(*calibrated)) < KEPT_G
                yield n, _angle_deg(gravity, calibrated), kept

    def _gravity(self, static_v: Sequence[float], n: int) -> tuple[float, ...]:
        """Accelerometer n's output at rest, g."""
        zero, sensitivity = self._nominal[n] or (0.0, 1.0)
        return tuple((v - zero) / sensitivity for v in static_v[3 * n : 3 * n + 3])


def _angle_deg(a: Sequence[float], b: Sequence[float]) -> float:
    """Between two outputs at rest, in g; 0 where one shows no attitude."""
    cosine = sum(x * y for x, y in zip(a, b, strict=True))
    lengths = math.hypot(*a), math.hypot(*b)
    if min(lengths) < LEAST_G:
        return 0.0
    return math.degrees(math.acos(max(-1.0, min(1.0, cosine / (lengths[0] * lengths[1])))))

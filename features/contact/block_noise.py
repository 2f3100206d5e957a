"""The noise of a stream's blocks: that at rest, and more while a sliding object makes the skin vibrate."""

import numpy as np

# Both are chosen on synthetic paths (experiments/LOG.md). The limit is in variances at rest; noise alone exceeds it
# four times in a thousand.
MEMORY_S = 0.5
LARGEST_AT_REST = 2.0


class BlockNoise:
    """Of one stream. rest_v: (C,) V, standard deviation of a block's mean at rest; block_s: length of a block.

    Estimated from second differences of three blocks in a row, in which neither the output nor its slope is left.
    """

    def __init__(self, rest_v: np.ndarray, block_s: float) -> None:
        self._rest_v2, self._share = rest_v**2, block_s / MEMORY_S
        self.reset()

    def reset(self) -> None:
        """Back to the noise at rest."""
        self._variance = self._rest_v2

    def push(self, blocks: np.ndarray) -> None:
        """Takes the means (3, C) V of the last three blocks."""
        bend = blocks[0] - 2 * blocks[1] + blocks[2]
        # White noise of variance 1 has second differences of variance 6.
        self._variance = self._variance + self._share * (bend**2 / 6 - self._variance)

    @property
    def vibration_v2(self) -> np.ndarray:
        """(C,) V^2: what the variance of a block's mean is larger by than at rest."""
        vibrates = self._variance > LARGEST_AT_REST * self._rest_v2
        return np.where(vibrates, self._variance - self._rest_v2, 0.0)

    @property
    def now_v(self) -> np.ndarray:
        """(C,) V: standard deviation of a block's mean now."""
        return np.sqrt(self._rest_v2 + self.vibration_v2)

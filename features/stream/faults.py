"""Which samples and which accelerometers may be believed, a block at a time.

A sample that is no number, or that lies beyond what the supply lets an accelerometer say, is lost; a block's mean
is that of the others. While a block has lost more than half of its samples, the one before stands in for it, for a
tenth of a second; after that the accelerometer is at fault. So it is when one of its channels stands still to the
last bit though another channel moves: noise never lets a live one do that.
"""

from operator import eq
from typing import NamedTuple

import numpy as np

# Blocks that may go by without a believable mean before an accelerometer is at fault.
BRIDGED_BLOCKS = 5
# Blocks that a channel may stand still while others move.
FROZEN_BLOCKS = 25


class Judged(NamedTuple):
    """One block: mean (C,) V, always finite; healthy (A,) and bridged (A,), those whose mean is an old one."""

    mean: np.ndarray
    healthy: np.ndarray
    bridged: np.ndarray


class SignalWatch:
    """Judges one stream's blocks.

    low_v, high_v: (C,) V, bounds of what a channel can show. read: (C,) bool, the channels that a model reads;
    the others count for nothing.
    """

    def __init__(self, low_v: np.ndarray, high_v: np.ndarray, read: np.ndarray) -> None:
        self._low, self._high, self._read = low_v, high_v, read
        self._highest_low, self._lowest_high = float(low_v.max()), float(high_v.min())
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        channels = len(self._read)
        self._missed = np.zeros(channels, dtype=np.intp)
        self._still = np.zeros(channels, dtype=np.intp)
        self._mean = np.zeros(channels)
        self._healthy, self._unbridged = np.ones(channels // 3, bool), np.zeros(channels // 3, bool)
        self._clear = True

    def push(self, samples: np.ndarray) -> Judged:
        """samples: (S, C) V, one block."""
        last = self._mean
        if (
            np.minimum.reduce(samples, axis=None) >= self._highest_low
            and np.maximum.reduce(samples, axis=None) <= self._lowest_high
        ):
            self._mean = np.add.reduce(samples) / len(samples)
            # Nearly every block; in few calls, since each costs more than what it works out.
            if self._clear and not any(map(eq, self._mean.tolist(), last.tolist())):
                return Judged(self._mean, self._healthy, self._unbridged)
            missed = np.zeros(len(last), dtype=bool)
        else:
            self._mean, missed = self._mean_of_good(samples)
        still = (samples == samples[0]).all(axis=0) & (self._mean == last)
        # A whole stream that stands still shows nothing, and claims nothing.
        self._still = np.where(still, self._still + (not still[self._read].all()), 0)
        self._missed = np.where(missed, self._missed + 1, 0)
        self._clear = not (missed.any() or still.any())
        bad = (self._missed > BRIDGED_BLOCKS) | (self._still >= FROZEN_BLOCKS)
        return Judged(self._mean, ~self._any(bad), self._any(missed))

    def _mean_of_good(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Means (C,) V of the believable samples, the last ones where too few are left, and where that is (C,)."""
        # NaN compares false, and infinities are beyond any bound.
        good = (samples >= self._low) & (samples <= self._high)
        count = good.sum(axis=0)
        missed = 2 * count < len(samples)
        mean = np.where(good, samples, 0.0).sum(axis=0) / np.maximum(count, 1)
        return np.where(missed, self._mean, mean), missed

    def _any(self, channels: np.ndarray) -> np.ndarray:
        """Channels (C,) -> accelerometers (A,): whether one of its channels that are read is so."""
        return (channels & self._read).reshape(-1, 3).any(axis=1)

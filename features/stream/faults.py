"""Lost samples and faulty accelerometers, judged a block at a time.

A sample is lost where it is not a number, or at an end of the supply's range or outside it: an output never reaches
either end, and converters and drivers write just these where they have no sample. A block's mean is that of the others.
When a block has lost more than half of a channel's samples, the channel's last mean is used again, for a tenth of a
second at most; after that the accelerometer is faulty. It is faulty too when one of its channels repeats the same bits
while another channel changes, for longer than its noise and its converter let a working one do. And it is faulty where
a channel is clipped: where many samples of two blocks in a row have the same largest or the same least value.
"""

import math
from collections.abc import Mapping, Sequence
from operator import eq
from typing import Any, NamedTuple

import numpy as np

from softslide.features.stream.conditioning import WHOLE, block_mean
from softslide.features.stream.drift import measures_gravity

# Blocks, 0.1 s, for which an old mean may be used before the accelerometer is faulty.
BRIDGED_BLOCKS = 5
# Blocks, 0.5 s at least, that a channel may repeat the same bits while others change. Noise of 5 mV and a converter of
# 0.5 mV never do that for one block. A coarse one that does so for longer does it once in so many times.
FROZEN_BLOCKS = 25
FROZEN_BY_CHANCE = 1e-6
# A channel is clipped where in so many blocks, each with the same end as the one before, this share of the samples lies
# at that end, if its noise is so large that usually the other share of a block's samples differ. Normal noise of three
# steps of the converter has 40 % of 20 samples at one end in 6 of 100 000 blocks.
CLIPPED_BLOCKS = 2
CLIPPED_SHARE = 0.4
DIFFERENT_SHARE = 0.5
LEAST_SAMPLES = 12  # of a block in which that can be detected


class Judged(NamedTuple):
    """One block: mean (C,) V, always finite; healthy (A,); bridged (A,), where some channel's mean is an old one."""

    mean: np.ndarray
    healthy: np.ndarray
    bridged: np.ndarray


class SignalWatch:
    """Judges one stream's blocks.

    low_v, high_v: (C,) V, ends of each channel's range. read: (C,) bool, the channels that a model reads; faults of the
    others are ignored. frozen_blocks: after how many that are the same a channel is faulty.
    """

    def __init__(
        self, low_v: np.ndarray, high_v: np.ndarray, read: np.ndarray, frozen_blocks: float = FROZEN_BLOCKS
    ) -> None:
        self._frozen_blocks = frozen_blocks
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
        # (C,) each: the last block's extremes, and whether the channel's noise shows when it is clipped; None: unknown.
        # (2, C) blocks in a row that end alike, below and above.
        self._lowest, self._highest = np.full(channels, np.nan), np.full(channels, np.nan)
        self._noisy: np.ndarray | None = None
        self._at_end = np.zeros((2, channels), dtype=np.intp)

    def push(self, samples: np.ndarray, shares: tuple[float, float] = WHOLE, touched: bool = True) -> Judged:
        """samples: (S, C) V, one block; shares: of its first and last sample, the part within the block; touched:
        whether something may touch the skin, without which nothing is clipped."""
        last = self._mean
        clipped = self._clipped(samples) if touched or self._noisy is None else None
        if (
            np.minimum.reduce(samples, axis=None) > self._highest_low
            and np.maximum.reduce(samples, axis=None) < self._lowest_high
        ):
            self._mean = block_mean(samples, shares)
            # The usual block, in as few calls of numpy as possible.
            if self._clear and clipped is None and not any(map(eq, self._mean.tolist(), last.tolist())):
                return Judged(self._mean, self._healthy, self._unbridged)
            missed = np.zeros(len(last), dtype=bool)
        else:
            self._mean, missed = self._mean_of_good(samples, shares)
        still = (samples == samples[0]).all(axis=0) & (self._mean == last)
        # When every channel repeats itself, the stream is quiet (or simulated) and no accelerometer is to blame.
        self._still = np.where(still, self._still + (not still[self._read].all()), 0)
        self._missed = np.where(missed, self._missed + 1, 0)
        self._clear = not (missed.any() or still.any())
        bad = (self._missed > BRIDGED_BLOCKS) | (self._still >= self._frozen_blocks)
        if clipped is not None:
            bad |= clipped
        return Judged(self._mean, ~self._any(bad), self._any(missed))

    def _clipped(self, samples: np.ndarray) -> np.ndarray | None:
        """(C,): the clipped channels of a block (S, C) V; None: none is."""
        lowest, highest = np.minimum.reduce(samples), np.maximum.reduce(samples)
        before = self._lowest, self._highest
        self._lowest, self._highest = lowest, highest
        if self._noisy is None:
            if (lowest > self._low).all() and (highest < self._high).all():
                different = np.array([len(np.unique(channel)) for channel in samples.T])
                self._noisy = (different >= DIFFERENT_SHARE * len(samples)) & (len(samples) >= LEAST_SAMPLES)
            return None
        if not (
            any(map(eq, lowest.tolist(), before[0].tolist()))
            or any(map(eq, highest.tolist(), before[1].tolist()))
        ):
            self._at_end[:] = 0
            return None
        for n, (now, then) in enumerate(((lowest, before[0]), (highest, before[1]))):
            # Either end of the range stands for a lost sample.
            same = (now == then) & (now > self._low) & (now < self._high) & self._noisy
            same &= (samples == now).mean(axis=0) >= CLIPPED_SHARE
            self._at_end[n] = np.where(same, self._at_end[n] + 1, 0)
        clipped = self._at_end.max(axis=0) >= CLIPPED_BLOCKS
        return clipped if clipped.any() else None

    def _mean_of_good(
        self, samples: np.ndarray, shares: tuple[float, float]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Means (C,) V of the samples that are not lost, or the last means; and where the last ones were used (C,)."""
        # NaN compares false, and infinities are beyond any bound.
        good = (samples > self._low) & (samples < self._high)
        missed = 2 * good.sum(axis=0) < len(samples)
        weight = good.astype(float)
        weight[0] *= shares[0]
        weight[-1] *= shares[1]
        mean = (np.where(good, samples, 0.0) * weight).sum(axis=0) / np.where(missed, 1.0, weight.sum(axis=0))
        return np.where(missed, self._mean, mean), missed

    def _any(self, channels: np.ndarray) -> np.ndarray:
        """Channels (C,) -> accelerometers (A,): whether any channel of it that is read is marked."""
        return (channels & self._read).reshape(-1, 3).any(axis=1)


def frozen_blocks(step_v: float, noise_v: float, samples: float) -> float:
    """How many blocks of so many samples a working channel may show the same reading for; infinite: any number.

    step_v: of its converter; 0: not known. noise_v: standard deviation of a sample as it is read, which is larger than
    the output's own by that of rounding (W. F. Sheppard, Proc. London Math. Soc. s1-29, 1898).
    """
    own_v = math.sqrt(max(noise_v**2 - step_v**2 / 12, 0.0))
    # Within one step: the output in its middle, where it stays the longest.
    within = math.erf(step_v / (math.sqrt(8) * own_v)) if own_v > 0 else 1.0
    if step_v <= 0 or within <= 0:
        return FROZEN_BLOCKS
    if within >= 1:
        return math.inf
    return max(FROZEN_BLOCKS, math.log(FROZEN_BY_CHANCE) / math.log(within) / samples)


def output_range(elements: Sequence[Mapping[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest output (C,) V of a card's sensing elements.

    Without acceleration an accelerometer's output is half its supply, and no output is outside the supply. Of other
    kinds no range is known: every finite number is an output.
    """
    largest = float(np.finfo(float).max)
    ranges = [
        (0.0, 2.0 * float(a["zero_g_v"])) if measures_gravity(a) else (-largest, largest) for a in elements
    ]
    low, high = np.repeat(np.array(ranges), 3, axis=0).T
    return low, high

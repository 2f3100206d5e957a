"""Volts at the sample rate become block means at a rate that a decision needs."""

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Conditioning:
    """Constants of the signal path; they travel in the model card.

    block_s: length of one block in s. 20 ms holds a whole period of 50 Hz mains, so the mean cancels it and
        its harmonics (the first null of a boxcar lies at 1 / block_s).
    rest_blocks: memory of the static output in blocks: a mean at first, then an exponential average, so that
        the zero follows temperature and pressure while nothing touches.
    trigger_v: a slide begins when the mean of `trigger_blocks` blocks of some V_x or V_y leaves the static
        output by this much, in V.
    release_v: a slide is over when every V_x and V_y has stayed this close to the static output, in V.
    still_share: share of the slide's blocks without change (or with no signal) after which it has ended.
    still_change: what counts as no change, as a share of the slide's largest output.
    still_peak_v: a stop on the dome is looked for only in slides that have reached this output in V: in
        weaker ones a slow slide and a stop look alike.
    least_blocks: blocks since the trigger before the first estimate.
    """

    block_s: float = 0.02
    rest_blocks: int = 150
    trigger_blocks: int = 5
    trigger_v: float = 0.005
    release_v: float = 0.0035
    still_share: float = 0.2
    still_change: float = 0.012
    still_peak_v: float = 0.04
    least_blocks: int = 8

    def __post_init__(self) -> None:
        for field in fields(self):
            if not getattr(self, field.name) > 0:
                raise ValueError(f"{field.name} is {getattr(self, field.name)}; it must be positive")
        if self.release_v > self.trigger_v:
            raise ValueError("release_v exceeds trigger_v; a slide would end as it begins")


class BlockMean:
    """Anti-alias filter and decimator in one: the mean of each whole block of samples.

    A block is averaged only once all its samples are there, so the numbers do not depend on how the samples
    were cut into chunks.
    """

    def __init__(self, channels: int, samples_per_block: int) -> None:
        self._pending = np.empty((samples_per_block, channels))
        self._count = 0

    def reset(self) -> None:
        """Forgets the samples of an unfinished block."""
        self._count = 0

    def push(self, volts: np.ndarray) -> np.ndarray:
        """volts (n, C) V -> (m, C) V, the means of the m blocks that these samples finish."""
        size = len(self._pending)
        means = np.empty(((self._count + len(volts)) // size, self._pending.shape[1]))
        taken = 0
        for mean in means:
            part = size - self._count
            self._pending[self._count :] = volts[taken : taken + part]
            taken += part
            self._count = 0
            self._pending.mean(axis=0, out=mean)
        rest = len(volts) - taken
        self._pending[self._count : self._count + rest] = volts[taken:]
        self._count += rest
        return means

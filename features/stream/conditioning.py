"""Samples to block means, and the constants of the signal path."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True)
class Conditioning:
    """Constants of the signal path; they travel in the model card. Figures in parentheses are of the defaults.

    With noise of 5 mV a sample at 1 kHz a block mean has 1.1 mV, the mean of `trigger_blocks` 0.5 mV.

    block_s: length of one block in s. 20 ms holds a whole period of 50 Hz mains, so that the mean cancels it and
        its harmonics (the first null of a boxcar lies at 1 / block_s).
    rest_blocks: memory of the static output in blocks (30 s): a mean at first, then an exponential average, so that
        it follows temperature and pressure. With 3 s it ran after slow slides (experiments/LOG.md).
    calm_v: a mean further from the static output than this, in V, moves it at a tenth of the pace.
    trigger_blocks, trigger_v: a slide begins when the mean of `trigger_blocks` blocks of some V_x or V_y leaves the
        static output by `trigger_v` V (ten standard deviations of the noise).
    release_v: a slide is over when every V_x and V_y has stayed this close to the static output, in V; below
        `trigger_v`, so that noise at the threshold does not begin and end slides.
    still_share: share of the slide's blocks without change, or without signal, after which it has ended.
    still_change: what counts as no change, as a share of the slide's largest output.
    still_peak_v: a stop on the skin is looked for only in slides that have reached this output in V: in weaker ones
        the noise hides the difference between a slow slide and a stop.
    least_blocks: blocks since the trigger before the first estimate.
    touch_blocks: a signal that changes in shape only within this many blocks of the trigger (0.24 s) is no slide but
        a touch: something set down or lifted off, or a jump of the zero.
    longest_blocks: a slide that has not ended after so many blocks (5 min) is slower than any that a model knows, or
        a shifted zero; it is given up.
    delayed, tau_s: the skin's lag as a standard linear solid: of every change the share `delayed` follows with the
        retardation time `tau_s` in s. It is undone in a slide's history; `delayed` 0: no lag is known.

    Raises:
        ValueError: a value of another type, not positive or not finite; `delayed` of 1 or more; `release_v` above
            `trigger_v`.
    """

    block_s: float = 0.02
    rest_blocks: int = 1500
    calm_v: float = 0.0015
    trigger_blocks: int = 5
    trigger_v: float = 0.005
    release_v: float = 0.0035
    still_share: float = 0.2
    still_change: float = 0.012
    still_peak_v: float = 0.04
    least_blocks: int = 8
    touch_blocks: int = 12
    longest_blocks: int = 15_000
    delayed: float = 0.0
    tau_s: float = 0.15

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, int if field.type is int else int | float):
                raise ValueError(f"{field.name} is {value!r}, not a number of its kind")
            if not 0 < value < math.inf and not (field.name == "delayed" and value == 0):
                raise ValueError(f"{field.name} is {value}; it must be positive and finite")
        if self.delayed >= 1:
            raise ValueError(f"delayed is {self.delayed}; it is a share, below 1")
        if self.release_v > self.trigger_v:
            raise ValueError("release_v exceeds trigger_v; a slide would end as it begins")

    @property
    def lag_s(self) -> float:
        """How late the response to a steady change is, s."""
        return self.delayed * self.tau_s

    @property
    def creep(self) -> float:
        """Share of its distance to the output y by which the delayed part z approaches it in one block.

        With the equilibrium response r and d = `delayed`, a standard linear solid has y = (1 - d) r + d z and
        tau z' = r - z. Eliminating r: (1 - d) tau z' = y - z, so that z follows from the output alone, and integrating
        r = y + d tau z' gives the equilibrium's integral, int r = int y + d tau z.
        """
        return 1.0 - math.exp(-self.block_s / ((1.0 - self.delayed) * self.tau_s))


class Blocks:
    """Cuts a stream into blocks of S samples; the blocks do not depend on the chunks that it comes in."""

    def __init__(self, channels: int, samples_per_block: int) -> None:
        self._samples = np.empty((samples_per_block, channels))
        self._count = 0

    def reset(self) -> None:
        """Forgets the samples of an unfinished block."""
        self._count = 0

    def push(self, volts: np.ndarray) -> Iterator[np.ndarray]:
        """volts (n, C) V -> the blocks (S, C) V float64 that these samples complete, each overwritten by the next."""
        size = len(self._samples)
        taken = 0
        while len(volts) - taken >= size - self._count:
            part = size - self._count
            self._samples[self._count :] = volts[taken : taken + part]
            taken += part
            self._count = 0
            yield self._samples
        rest = len(volts) - taken
        self._samples[self._count : self._count + rest] = volts[taken:]
        self._count += rest


class BlockMean:
    """Anti-alias filter and decimator: the mean of each block."""

    def __init__(self, channels: int, samples_per_block: int) -> None:
        self._blocks = Blocks(channels, samples_per_block)
        self._channels = channels

    def push(self, volts: np.ndarray) -> np.ndarray:
        """volts (n, C) V -> (m, C) V, the means of the m blocks that these samples complete."""
        means = [samples.mean(axis=0) for samples in self._blocks.push(volts)]
        return np.array(means).reshape(len(means), self._channels)


def without_lag(blocks: np.ndarray, conditioning: Conditioning) -> np.ndarray:
    """Block means (m, C) V of a whole recording, with the skin's lag undone; r of `Conditioning.creep`.

    `SlideHistory` does the same a block at a time, to the integral of r.
    """
    crept, before = np.zeros_like(blocks), np.zeros(blocks.shape[1:])
    for n, output in enumerate(blocks - blocks[0]):
        crept[n] = before = conditioning.creep * output + (1.0 - conditioning.creep) * before
    # r = y + d tau z'
    return blocks + conditioning.lag_s / conditioning.block_s * np.diff(
        crept, axis=0, prepend=0.0 * crept[:1]
    )

"""Samples to block means, and the constants of the signal path.

A block is a time: `Conditioning.block_s`. Where the rate makes it no whole number of samples, the sample that an edge
of a block falls on counts in both blocks, in each by its share. So a mean is over exactly `block_s`, which cancels
mains, and blocks do not drift against time.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

# Samples; what an edge of a block is less than this away from a sample's is rounding, at any rate and for years.
ROUNDING = 1e-4
# Shares of a block's first and last sample, where it holds whole samples alone.
WHOLE = (1.0, 1.0)
TOUCH_AXES = ("xy", "xyz")
ONSETS = ("rim", "touch")
# The largest value of a field, by its name or its unit: orders of magnitude beyond any sensor that is built. They bound
# the memory and the work of a stream; an estimate is made of the mean of `trigger_blocks`, held in memory.
MOST = {"block_s": 1.0, "trigger_blocks": 1000, "blocks": 1_000_000, "v": 1e3, "s": 1e6}
# Of a factor or a share; above it, arithmetic overflows.
LARGEST = 1e12


@dataclass(frozen=True)
class Conditioning:
    """Constants of the signal path; they travel in the model card. Figures in parentheses are of the defaults.

    With noise of 5 mV a sample at 1 kHz a block mean has 1.1 mV, the mean of `trigger_blocks` 0.5 mV.

    scale: what volts are multiplied by first. The constants in V below, the response map and the networks are made for
        0.8 V/g; a sensor of 0.2 V/g has a scale of 4 (pipeline/recordings/at_rest.py).
    block_s: length of one block in s. 20 ms holds a whole period of 50 Hz mains, so that the mean cancels it and
        its harmonics (the first null of a boxcar lies at 1 / block_s).
    rest_blocks: memory of the static output in blocks (30 s): a mean at first, then an exponential average, so that
        it follows temperature and pressure. With 3 s it ran after slow slides (experiments/LOG.md).
    calm_v: a mean further from the static output than this, in V, changes it at a tenth of the rate.
    trigger_blocks, trigger_v: a slide begins when the mean of `trigger_blocks` blocks of some V_x or V_y leaves the
        static output by `trigger_v` V (ten standard deviations of the noise).
    release_v: a slide is over when every V_x and V_y has stayed this close to the static output, in V; below
        `trigger_v`, so that noise at the threshold does not begin and end slides.
    still_share: share of the slide's blocks without change, or without signal, after which it has ended.
    still_change: what counts as no change, as a share of the slide's largest output.
    still_peak_v: a stop on the skin is looked for only in slides that have reached this output in V: in weaker ones
        the noise hides the difference between a slow slide and a stop.
    least_blocks: blocks since the trigger before the first estimate.
    touch_blocks: a signal that changes in shape only within this many blocks of the trigger (0.24 s) is not a slide but
        a touch: something set down or lifted off, or a jump of the zero.
    longest_blocks: a slide that has not ended after so many blocks (5 min) is slower than any that a model knows, or
        a shifted zero; it is given up.
    delayed, tau_s: the skin's lag as a standard linear solid: of every change the share `delayed` follows with the
        retardation time `tau_s` in s. It is undone in a slide's history; `delayed` 0: no lag is known.
    touch_axes: of each sensing element that answer to a touch: "xy", V_x and V_y, of accelerometers; "xyz" where V_z
        does too. The figures in V are in the sensor's own unit where that is another.
    onset: how a slide begins and ends: "rim", the contact comes in over the chamber's rim and goes out across it, where
        nothing shows; "touch", it comes down and is lifted anywhere, and the output jumps. What lies before and after
        the jump is then no part of the slide.
    gravity_sd_g: standard deviation in g of the length of gravity over contacts, where accelerometers only tilt
        (features/stream/gravity.py). The default refuses what no robot's arm does (experiments/LOG.md).

    Raises:
        ValueError: a value of another type, not positive or above its largest (MOST); `delayed` of 1 or more;
            `release_v` above `trigger_v`; other axes.
    """

    scale: float = 1.0
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
    touch_axes: str = TOUCH_AXES[0]
    onset: str = ONSETS[0]
    gravity_sd_g: float = 0.0625

    def __post_init__(self) -> None:
        if self.touch_axes not in TOUCH_AXES:
            raise ValueError(f"touch_axes is {self.touch_axes!r}; it must be one of {', '.join(TOUCH_AXES)}")
        if self.onset not in ONSETS:
            raise ValueError(f"onset is {self.onset!r}; it must be one of {', '.join(ONSETS)}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.type is str:
                continue
            if isinstance(value, bool) or not isinstance(value, int if field.type is int else int | float):
                raise ValueError(f"{field.name} is {value!r}, not a number of its kind")
            most = MOST.get(field.name) or MOST.get(field.name.rpartition("_")[2], LARGEST)
            if not 0 < value <= most and not (field.name == "delayed" and value == 0):
                raise ValueError(f"{field.name} is {value}; it must be positive and at most {most:g}")
        if self.delayed >= 1:
            raise ValueError(f"delayed is {self.delayed}; it is a share, below 1")
        if self.release_v > self.trigger_v:
            raise ValueError("release_v exceeds trigger_v; a slide would end as it begins")

    def block_samples(self, rate_hz: float) -> float:
        """Length of a block in samples at `rate_hz` Hz: not always a whole number."""
        return self.block_s * rate_hz

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
    """Cuts a stream into blocks; they do not depend on the chunks that it comes in.

    length: of a block in samples (`Conditioning.block_samples`), 1 or more.
    """

    def __init__(self, channels: int, length: float) -> None:
        self._length = length
        self._samples = np.empty((math.ceil(length) + 1, channels))
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self._count = 0
        self._begin(0)

    def _begin(self, number: int) -> None:
        """The block of that number is next: how many samples it touches, and the shares of the first and the last."""
        begin, end = number * self._length, (number + 1) * self._length
        first, behind = math.floor(begin + ROUNDING), math.ceil(end - ROUNDING)
        self._number, self._size = number, behind - first
        self._shares = min(first + 1 - begin, 1.0), min(end - behind + 1, 1.0)

    def push(self, volts: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[float, float]]]:
        """volts (n, C) V -> the blocks that these samples complete, as `block_mean` takes them.

        Each is samples (S, C) V float64, overwritten by the next, and the shares of the first and the last of them.
        """
        taken = 0
        while len(volts) - taken >= self._size - self._count:
            part = self._size - self._count
            self._samples[self._count : self._size] = volts[taken : taken + part]
            taken += part
            samples, shares = self._samples[: self._size], self._shares
            yield samples, shares
            # A sample that the edge cuts begins the next block.
            self._count = int(shares[1] < 1.0 - ROUNDING)
            self._samples[: self._count] = samples[-1]
            self._begin(self._number + 1)
        rest = len(volts) - taken
        self._samples[self._count : self._count + rest] = volts[taken:]
        self._count += rest


def block_mean(samples: np.ndarray, shares: tuple[float, float] = WHOLE) -> np.ndarray:
    """Mean (C,) V of a block's samples (S, C) V, of which the first and the last count by their share."""
    total = np.add.reduce(samples)
    if shares == WHOLE:
        return total / len(samples)
    missing = 1.0 - shares[0], 1.0 - shares[1]
    return (total - missing[0] * samples[0] - missing[1] * samples[-1]) / (len(samples) - sum(missing))


def block_means(volts: np.ndarray, conditioning: Conditioning, rate_hz: float) -> np.ndarray:
    """Anti-alias filter and decimator: volts (n, C) V at `rate_hz` Hz -> means (m, C) V of the m whole blocks, scaled.

    Block k is the time from k `block_s` to (k + 1) `block_s` after the first sample.
    """
    length, channels = conditioning.block_samples(rate_hz), volts.shape[1]
    if length == round(length):
        # The same sums, all blocks at once.
        whole = np.ascontiguousarray(volts[: len(volts) // round(length) * round(length)], float)
        return conditioning.scale * (whole.reshape(-1, round(length), channels).sum(axis=1) / length)
    means = [block_mean(*block) for block in Blocks(channels, length).push(volts)]
    return conditioning.scale * np.array(means).reshape(len(means), channels)


def blocks_in(samples: np.ndarray, length: float) -> np.ndarray:
    """Number of blocks of `length` samples that each of so many samples (k,) complete."""
    return np.floor((samples + ROUNDING) / length).astype(int)


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


class LagUndone:
    """Undoes the skin's lag in a running stream of block means, as `without_lag` does in a whole recording.

    noise_gain: standard deviation of what comes out over that of white noise that goes in.
    """

    def __init__(self, conditioning: Conditioning, channels: int) -> None:
        self._lag_blocks, self._creep = conditioning.lag_s / conditioning.block_s, conditioning.creep
        self._crept = np.zeros(channels)
        # y + L (z_n - z_(n-1)), z the exponential average of y: 1 + L c on the newest block, little on those before.
        self.noise_gain = 1.0 + self._lag_blocks * self._creep

    def reset(self) -> None:
        """Back to an output of zero."""
        self._crept[:] = 0.0

    def push(self, subtracted: np.ndarray) -> np.ndarray:
        """One block (C,) V -> (C,) V."""
        change = self._creep * (subtracted - self._crept)
        self._crept += change
        return subtracted + self._lag_blocks * change

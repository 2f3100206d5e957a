"""Places time-stamped samples in even slots, so that the slots keep the stamps' time and not the number of samples.

A lost sample leaves an empty slot. Where samples come faster than slots, one is left out now and then. Stamps need not
be even: a computer that stamps what comes over USB or a network stamps late, by what the samples waited, and gives all
of a packet one stamp. The samples then keep their order and are taken to be even; how late they are is how late the
least late of the last quarter second is, which waited least.
"""

from collections import deque
from collections.abc import Iterator

import numpy as np

from softslide.features.errors import InputError

# Samples by which stamps may be early: jitter of a sample or two. Earlier still means a clock faster than the nominal
# rate, and a sample is left out.
AHEAD = 2.0
# Sample times: no clock that ticks evenly makes a shorter step, up to four times the nominal rate.
SHORT_STEP = 0.25
# s: of uneven stamps the least late in this time counts. Packets are shorter.
SPAN_S = 0.25
# Spans for which stamps count as uneven after a short step.
MEMORY_SPANS = 4


class SampleClock:
    """One stream's clock.

    longest: samples. A longer gap, or time that runs back by more, breaks the stream and leaves `longest` empty slots.
    start_s: time of the first slot, moved at a break, so that start_s + slot / rate is a slot's time after it.
    """

    def __init__(self, rate_hz: float, longest: int) -> None:
        self._rate, self._longest = rate_hz, longest
        self._span = max(1, round(SPAN_S * rate_hz))
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self.start_s = 0.0
        self._last: float | None = None
        self._slots = 0
        self._begin()

    def _begin(self) -> None:
        """The next sample is on time, and stamps count as even."""
        # Samples by which the last one is later than its slot.
        self._late = 0.0
        self._uneven = 0
        # Of uneven stamps: number of samples; slots left empty less samples left out; and, with rising lateness, the
        # (number, lateness without that shift) of samples that are or will be the least late of a span.
        self._count = self._shift = 0
        self._least: deque[tuple[int, float]] = deque()

    def place(self, volts: np.ndarray, time_s: np.ndarray | None) -> Iterator[np.ndarray]:
        """volts (n, C) V at times (n,) s -> the rows of successive slots, in pieces; an empty slot is a row of NaN.

        time_s None: each sample follows the one before.
        """
        if not len(volts):
            return
        if time_s is None:
            self._last = None
            self._slots += len(volts)
            yield volts
            return
        if self._last is None:
            self.start_s = float(time_s[0]) - self._slots / self._rate
            self._last = float(time_s[0]) - 1.0 / self._rate
            self._begin()
        # A time beyond all bounds breaks the stream.
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.diff(time_s, prepend=self._last) * self._rate
            # How late each sample is; summed one by one, so that the result does not depend on the chunks.
            late = np.cumsum(np.concatenate([[self._late], steps - 1.0]))[1:]
        self._last = float(time_s[-1])
        if not self._uneven and (np.abs(late) < 0.5).all() and (steps >= SHORT_STEP).all():
            self._late = float(late[-1])
            self._slots += len(volts)
            yield volts
            return
        begun = 0
        for n, step in enumerate(steps.tolist()):
            least = self._lateness(step)
            if not -self._longest <= least <= self._longest:
                yield volts[begun:n]
                begun = n
                self._begin()
                self.start_s = float(time_s[n]) - (self._slots + self._longest) / self._rate
                yield self._empty(self._longest, volts)
            elif least >= 0.5:
                yield volts[begun:n]
                begun = n
                self._move(round(least))
                yield self._empty(round(least), volts)
            elif least < -AHEAD:
                yield volts[begun:n]
                begun = n + 1
                self._move(-1)
                continue
            self._slots += 1
        yield volts[begun:]

    def _empty(self, slots: int, volts: np.ndarray) -> np.ndarray:
        self._slots += slots
        return np.full((slots, volts.shape[1]), np.nan)

    def _move(self, slots: int) -> None:
        """The next sample's slot is later by so many."""
        self._late -= slots
        self._shift += slots

    def _lateness(self, step: float) -> float:
        """By how many samples the stream is late, with a sample that comes `step` sample times after the last one."""
        self._late += step - 1.0
        if step < SHORT_STEP:
            if not self._uneven:
                self._least.clear()
            self._uneven = MEMORY_SPANS * self._span
        elif self._uneven:
            self._uneven -= 1
        # What is later than any packet is a gap.
        if not self._uneven or not abs(self._late) <= self._longest + self._span:
            return self._late
        self._count += 1
        raw = self._late + self._shift
        while self._least and self._least[-1][1] >= raw:
            self._least.pop()
        self._least.append((self._count, raw))
        if self._least[0][0] <= self._count - self._span:
            self._least.popleft()
        return self._least[0][1] - self._shift


def checked_samples(
    volts: np.ndarray, time_s: np.ndarray | None, columns: int
) -> tuple[np.ndarray, np.ndarray | None]:
    """A chunk of samples (n, columns) V, and their times (n,) s where they have any.

    Raises:
        InputError: not real numbers, another shape, or a time that is not finite.
    """
    volts = _numbers(volts, "a chunk")
    if volts.ndim != 2 or volts.shape[1] != columns:
        raise InputError(f"a chunk has shape {volts.shape}; push (n, {columns}) volts")
    if time_s is None:
        return volts, None
    time_s = _numbers(time_s, "time_s").astype(float)
    if time_s.shape != volts.shape[:1] or not np.isfinite(time_s).all():
        raise InputError(
            f"time_s of shape {time_s.shape} for {len(volts)} samples; push a finite time in s for each"
        )
    return volts, time_s


def _numbers(values: np.ndarray, name: str) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{name} is ragged; push an array of real numbers") from None
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} is {array.dtype}; push real numbers")
    return array

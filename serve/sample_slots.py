"""Places time-stamped samples in even slots, so that a lost sample leaves an empty slot and not a shorter slide."""

from collections.abc import Iterator

import numpy as np

# Samples by which stamps may be early: jitter of a sample or two. Earlier still means a clock faster than the nominal
# rate, and the first slot's time is moved.
AHEAD = 2.0


class SampleClock:
    """One stream's clock.

    longest: samples. A longer gap, or time that runs back, breaks the stream and leaves `longest` empty slots.
    start_s: time of the first slot, moved at a break, so that start_s + slot / rate is a slot's time after it.
    """

    def __init__(self, rate_hz: float, longest: int) -> None:
        self._rate, self._longest = rate_hz, longest
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self.start_s = 0.0
        self._last: float | None = None
        self._late = 0.0
        self._slots = 0

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
            self._last, self._late = float(time_s[0]) - 1.0 / self._rate, 0.0
        steps = np.diff(time_s, prepend=self._last) * self._rate
        # How late each sample is, in samples; summed one by one, so that the result does not depend on the chunks.
        late = np.cumsum(np.concatenate([[self._late], steps - 1.0]))[1:]
        self._last = float(time_s[-1])
        if (np.abs(late) < 0.5).all() and (steps > 0).all():
            self._late = float(late[-1])
            self._slots += len(volts)
            yield volts
            return
        begun = 0
        for n, step in enumerate(steps.tolist()):
            lost, start_s = self._lost(step, float(time_s[n]))
            if lost or start_s != self.start_s:
                # The samples before this one belong to the old start_s.
                yield volts[begun:n]
                begun, self.start_s = n, start_s
                yield np.full((lost, volts.shape[1]), np.nan)
            self._slots += 1
        yield volts[begun:]

    def _lost(self, step: float, time_s: float) -> tuple[int, float]:
        """Slots to leave empty before a sample `step` sample times after the last one, and the new start_s in s."""
        self._late += step - 1.0
        broken = step < 0 or (step < 0.5 and self._late < -AHEAD - 1)
        lost = 0 if self._late < 0.5 else round(self._late)
        start_s = self.start_s
        if broken or lost > self._longest:
            lost, self._late = self._longest, 0.0
            start_s = time_s - (self._slots + lost) / self._rate
        elif self._late < -AHEAD:
            start_s += (self._late + AHEAD) / self._rate
            self._late = -AHEAD
        else:
            self._late -= lost
        self._slots += lost
        return lost, start_s

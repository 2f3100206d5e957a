"""How old a sample is, from when samples came: the least delay between its time and its coming counts as none."""

import math
from collections import deque

MEMORY_S = 10.0  # a device's clock that is 100 ppm off its nominal rate is off by 1 ms in it
# A pause between two arrivals counts as no more of the memory: what came before a hold-up shows how old that is which
# comes after it.
PAUSE_S = 0.2


class SampleAge:
    """One stream's. Times of samples are of the stream's clock, those of coming of this computer's, both in s."""

    def __init__(self) -> None:
        self._sample_s, self._now_s = math.inf, 0.0  # of the newest sample, and when it came
        self._received_s = 0.0  # for how long samples have been coming
        # (received, delay) with rising delay: those that are or will be the least of a memory.
        self._least: deque[tuple[float, float]] = deque()

    def came(self, time_s: float, now_s: float) -> None:
        """A sample of `time_s` came at `now_s`. Where time runs back the stream has begun anew."""
        if time_s < self._sample_s:
            self._least.clear()
        self._received_s += min(now_s - self._now_s, PAUSE_S)
        self._sample_s, self._now_s, delay = time_s, now_s, now_s - time_s
        while self._least and self._least[-1][1] >= delay:
            self._least.pop()
        self._least.append((self._received_s, delay))
        while self._least[0][0] < self._received_s - MEMORY_S:
            self._least.popleft()

    def of(self, time_s: float, now_s: float) -> float:
        """The age in s at `now_s` of a sample of `time_s`; NaN before any came."""
        return max(0.0, round(now_s - time_s - self._least[0][1], 3)) if self._least else math.nan

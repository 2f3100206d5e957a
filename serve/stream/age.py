"""How old a sample is, from when samples came: the least delay between its time and its coming counts as none."""

from collections import deque

MEMORY_S = 10.0  # a device's clock that is 100 ppm off its nominal rate is off by 1 ms in it


class SampleAge:
    """One stream's. Times of samples are of the stream's clock, those of coming of this computer's, both in s."""

    def __init__(self) -> None:
        self._last_s = -float("inf")
        # (came, delay) with rising delay: those that are or will be the least of a memory.
        self._least: deque[tuple[float, float]] = deque()

    def came(self, time_s: float, now_s: float) -> None:
        """A sample of `time_s` came at `now_s`. Where time runs back the stream has begun anew."""
        if time_s < self._last_s:
            self._least.clear()
        self._last_s, delay = time_s, now_s - time_s
        while self._least and self._least[-1][1] >= delay:
            self._least.pop()
        self._least.append((now_s, delay))
        while self._least[0][0] < now_s - MEMORY_S:
            self._least.popleft()

    def of(self, time_s: float, now_s: float) -> float:
        """The age in s at `now_s` of a sample of `time_s`; NaN before any came."""
        return max(0.0, round(now_s - time_s - self._least[0][1], 3)) if self._least else float("nan")

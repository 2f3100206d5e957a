"""A slide's history: the running integral of the subtracted output since the trigger, with the skin's lag undone.

The integral is kept at equal steps in a buffer that drops every other point when it is full. Memory is bounded, and
the resolution is a fixed share of the slide's duration, whatever the speed. A mean over any stretch is the integral's
increase over its length, so that no sample is thrown away: the longer the stretch, the lower its noise.
"""

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.stream.conditioning import Conditioning
from softslide.features.window import WINDOW_BINS, Window

# Four points a bin of the window when the buffer is full, two when it has just been halved.
BUFFER_POINTS = 4 * WINDOW_BINS
_BIN_EDGES = np.arange(WINDOW_BINS + 1.0)
_QUARTER_EDGES = np.arange(4.0, -1.0, -1.0)


class SlideHistory:
    """One slide since its trigger.

    static_v: (C,) V, the static output as it was at the trigger.
    usable: (A,), the accelerometers that the slide is read from; watched: indices of those of
        their channels that answer to a touch.
    blocks: number taken. peak_v: largest |subtracted output| of a watched channel so far. shown_blocks: number taken
        when one was last above the trigger.
    """

    def __init__(self, conditioning: Conditioning, static_v: np.ndarray, usable: np.ndarray) -> None:
        self._conditioning = conditioning
        self._touch = touch_channels(len(static_v), conditioning.touch_axes)
        self._lag_blocks, self._creep = conditioning.lag_s / conditioning.block_s, conditioning.creep
        self.static_v = static_v.copy()
        self.usable = usable
        self.watched = self._touch[usable[self._touch // 3]]
        self.blocks = self.shown_blocks = 0
        self.peak_v = 0.0
        # Of the output, V blocks; and of its creeping part z, V (Conditioning.creep).
        self._sum = np.zeros(len(static_v))
        self._crept = np.zeros(len(static_v))
        self._integral = np.zeros((len(static_v), BUFFER_POINTS + 2))
        # Points behind the first one, and blocks between two of them.
        self._points = 0
        self._stride = 1

    def push(self, block: np.ndarray) -> None:
        """Takes one block's mean (C,) V."""
        subtracted = block - self.static_v
        self._sum += subtracted
        so_far = self._sum
        if self._lag_blocks:
            self._crept += self._creep * (subtracted - self._crept)
            so_far = so_far + self._lag_blocks * self._crept
        shown_v = max(map(abs, subtracted[self.watched].tolist()))
        self.peak_v = max(self.peak_v, shown_v)
        self.blocks += 1
        if shown_v > self._conditioning.trigger_v:
            self.shown_blocks = self.blocks
        if self.blocks % self._stride == 0:
            self._points += 1
            self._integral[:, self._points] = so_far
            if self._points == BUFFER_POINTS:
                self._integral[:, : BUFFER_POINTS // 2 + 1] = self._integral[:, : BUFFER_POINTS + 1 : 2]
                self._points //= 2
                self._stride *= 2
        # Behind the last point the integral as it stands.
        self._integral[:, self._points + 1] = so_far

    def leave_out(self, dead: np.ndarray) -> None:
        """Reads the slide no longer from the accelerometers of the dead channels (C,)."""
        self.usable = self.usable & ~dead[::3]
        self.watched = self._touch[self.usable[self._touch // 3]]

    def window(self, blocks: int) -> Window:
        """The first `blocks` blocks in equal bins; zeros for accelerometers that are left out."""
        integral = self._integral_at(_BIN_EDGES * (blocks / WINDOW_BINS))
        means = (integral[:, 1:] - integral[:, :-1]) * (WINDOW_BINS / blocks)
        if not all(self.usable.tolist()):
            means[np.repeat(~self.usable, 3)] = 0.0
        return Window(means.astype(np.float32), blocks * self._conditioning.block_s)

    def last_quarters(self, quarter: int) -> np.ndarray:
        """(watched, 4) V: means over the last four stretches of `quarter` blocks each."""
        integral = self._integral_at(self.blocks - quarter * _QUARTER_EDGES)
        means = (integral[:, 1:] - integral[:, :-1]) / quarter
        return means[self.watched]

    def first_blocks(self, count: int) -> np.ndarray | None:
        """(watched, count) V: the first blocks one by one; None once they have been merged."""
        return np.diff(self._integral[self.watched, : count + 1]) if self._stride == 1 else None

    def _integral_at(self, blocks: np.ndarray) -> np.ndarray:
        """Integral (C, m) in V blocks at block counts (m,) since the trigger, linear between the points."""
        place = blocks / self._stride
        below = np.minimum(place.astype(np.intp), self._points)
        share = place - below
        # From the last point it is not a whole stride to the integral as it stands.
        share[below == self._points] *= self._stride / max(self.blocks - self._stride * self._points, 1)
        low = self._integral.take(below, axis=1)
        return low + share * (self._integral.take(below + 1, axis=1) - low)

"""Follows one stream of blocks through rest, slide and end, and keeps the slide's history.

The history is the running integral of the subtracted output since the trigger, in a buffer that drops every
other knot when it is full. Its memory is bounded and its resolution is a fixed share of the slide's duration:
a time scale that does not depend on speed. A mean over any stretch is the difference of two integrals, so
nothing measured is thrown away (the longer the stretch, the lower its noise).
"""

from enum import StrEnum

import numpy as np

from features.conditioning import Conditioning
from features.window import WINDOW_BINS, Window

KNOTS = 4 * WINDOW_BINS


class State(StrEnum):
    """What the stream shows: nothing so far, a slide, or the end of one."""

    REST = "rest"
    SLIDE = "slide"
    ENDED = "ended"


class SlideTracker:
    """State of one stream, a block at a time.

    tilt: indices of the V_x and V_y channels, the only ones that trigger and release.
    """

    def __init__(self, conditioning: Conditioning, channels: int) -> None:
        self.conditioning = conditioning
        self.tilt = np.array([c for c in range(channels) if c % 3 < 2])
        self._integral = np.zeros((KNOTS + 1, channels))
        self._recent = np.zeros((conditioning.trigger_blocks, channels))
        self.reset()

    def reset(self) -> None:
        """Back to an unknown static output."""
        self.state = State.REST
        self.static = np.zeros(self._recent.shape[1])
        self.final: Window | None = None
        self._rested = 0
        self._filled = 0
        self._blocks = 0
        self._stop_level: np.ndarray | None = None

    @property
    def known(self) -> bool:
        """Whether the static output is known well enough to subtract it."""
        return self._rested >= 2 * self.conditioning.trigger_blocks

    def push(self, block: np.ndarray) -> None:
        """Takes one block's mean (C,) V."""
        if self.state is State.SLIDE:
            self._extend(block)
            if self._blocks >= 2 * self.conditioning.least_blocks:
                self._watch_end()
            return
        oldest = self._recent[0].copy()
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = block
        self._filled += 1
        level = self._recent.mean(axis=0)
        zero = self.static if self._stop_level is None else self._stop_level
        moved = np.abs((level - zero)[self.tilt]).max() > self.conditioning.trigger_v
        if self.known and self._filled >= len(self._recent) and moved:
            self._begin()
        elif self._filled > len(self._recent) and self._stop_level is None:
            self._rested += 1
            self.static += (oldest - self.static) / min(self._rested, self.conditioning.rest_blocks)

    def window(self, blocks: int | None = None) -> Window | None:
        """The slide so far (or its first `blocks`) in equal bins; the last one when it has ended; else None."""
        if self.state is not State.SLIDE:
            return self.final
        if self._blocks < self.conditioning.least_blocks:
            return None
        return self._window(self._blocks if blocks is None else blocks)

    def _begin(self) -> None:
        self.state = State.SLIDE
        self._blocks = 0
        self._stride = 1
        self._peak = 0.0
        self._knots = 0
        self._sum = np.zeros(len(self.static))
        self._integral[0] = 0.0
        self._stop_level = None
        for block in self._recent:
            self._extend(block)
        self._filled = 0

    def _extend(self, block: np.ndarray) -> None:
        self._sum += block - self.static
        self._peak = max(self._peak, float(np.abs((block - self.static)[self.tilt]).max()))
        self._blocks += 1
        if self._blocks % self._stride == 0:
            self._knots += 1
            self._integral[self._knots] = self._sum
            if self._knots == KNOTS:
                self._integral[: KNOTS // 2 + 1] = self._integral[::2]
                self._knots //= 2
                self._stride *= 2

    def _integral_at(self, blocks: np.ndarray) -> np.ndarray:
        """Integral of the subtracted output (V blocks) at block counts (m,) since the trigger -> (m, C)."""
        position = blocks / self._stride
        lower = np.minimum(position.astype(np.intp), self._knots)
        share = (position - lower)[:, None]
        upper = self._integral[np.minimum(lower + 1, self._knots)]
        value = self._integral[lower] * (1.0 - share) + upper * share
        last = lower == self._knots
        if last.any():
            beyond = self._blocks - self._knots * self._stride
            toward = (blocks[last] - self._knots * self._stride) / max(beyond, 1)
            knot = self._integral[self._knots]
            value[last] = knot + (self._sum - knot) * toward[:, None]
        return value

    def _window(self, blocks: int) -> Window:
        edges = self._integral_at(np.arange(WINDOW_BINS + 1) * (blocks / WINDOW_BINS))
        means = np.diff(edges, axis=0) * (WINDOW_BINS / blocks)
        return Window(means.T.astype(np.float32), blocks * self.conditioning.block_s)

    def _watch_end(self) -> None:
        """Ends the slide when the contact has left the dome, or has come to a stop on it."""
        c = self.conditioning
        span = max(2 * c.trigger_blocks, int(c.still_share * self._blocks))
        if self._blocks % max(1, span // 8) or span > self._blocks // 2:
            return
        # Four quarters, not two halves: over an extreme, halves agree by symmetry while the contact moves on.
        quarter = span // 4
        marks = self._integral_at(self._blocks - quarter * np.arange(4, -1, -1))
        levels = np.diff(marks, axis=0)[:, self.tilt] / quarter
        if np.abs(levels[2:]).max() < c.release_v:
            self._end(self._blocks, None)
        elif self._peak > c.still_peak_v and np.ptp(levels, axis=0).max() < c.still_change * self._peak:
            self._end(self._blocks - 4 * quarter, (marks[4] - marks[3]) / quarter + self.static)

    def _end(self, blocks: int, stop_level: np.ndarray | None) -> None:
        self.final = self._window(max(blocks, self.conditioning.least_blocks))
        self.state = State.ENDED
        self._stop_level = stop_level


def track(blocks: np.ndarray, conditioning: Conditioning, read_at: np.ndarray) -> list[Window | None]:
    """The window as it stood after each of the block counts in `read_at` (ascending), the batch form.

    blocks: (m, C) V, means from `BlockMean`; read_at: (k,) numbers of blocks seen.
    """
    tracker = SlideTracker(conditioning, blocks.shape[1])
    windows: list[Window | None] = []
    seen = 0
    for count in read_at:
        for block in blocks[seen:count]:
            tracker.push(block)
        seen = max(seen, int(count))
        windows.append(tracker.window())
    return windows

"""Follows one stream of blocks through rest, slide and end, and keeps the slide's history.

The history is the running integral since the trigger of the subtracted output, the skin's lag undone, in a buffer
that drops every other knot when it is full. Its memory is bounded and its resolution is a fixed share of the slide's
duration: a time scale that does not depend on speed. A mean over any stretch is the difference of two integrals, so
nothing measured is thrown away (the longer the stretch, the lower its noise).
"""

from enum import StrEnum

import numpy as np

from features.angles import tilt_channels
from features.stream.conditioning import Conditioning
from features.window import WINDOW_BINS, Window

KNOTS = 4 * WINDOW_BINS
EDGES = np.arange(WINDOW_BINS + 1.0)
QUARTERS = np.arange(4.0, -1.0, -1.0)
# Share of the largest output, and of the trigger, by which a slide's signal has to change in more than its strength.
TOUCH_CHANGE = 0.06
TOUCH_TRIGGER = 0.5
# Blocks that a lost stream has to stand still for its output to be taken for the static one.
LOST_BLOCKS = 300
# Triggers that a signal has to reach to be called strong.
TOUCH_TRIGGERS = 4.0


class State(StrEnum):
    """What the stream shows: nothing so far, a slide, or the end of one."""

    REST = "rest"
    SLIDE = "slide"
    ENDED = "ended"


class SlideTracker:
    """State of one stream, a block at a time.

    tilt: indices of the V_x and V_y channels, the only ones that trigger and release.
    static: (C,) V, the static output, followed while nothing touches.
    usable: (A,), the accelerometers that the slide at hand, or the last one, is read from.
    """

    def __init__(self, conditioning: Conditioning, channels: int) -> None:
        self.conditioning = conditioning
        self.tilt = tilt_channels(channels)
        self._integral = np.zeros((channels, KNOTS + 2))
        self._recent = np.zeros((conditioning.trigger_blocks, channels))
        self._most_rested = max(conditioning.rest_blocks, 10 * conditioning.trigger_blocks)
        self._lag_blocks, self._creep = conditioning.lag_s / conditioning.block_s, conditioning.creep
        self._quiet_v = min(conditioning.calm_v, conditioning.trigger_v)
        self.reset()

    def reset(self) -> None:
        """Back to an unknown static output."""
        channels = self._recent.shape[1]
        self.state = State.REST
        self.static = np.zeros(channels)
        self.final: Window | None = None
        self.usable = np.ones(channels // 3, dtype=bool)
        self._rested = np.zeros(channels)
        self._filled = np.zeros(channels)
        self._blocks = 0
        self._moved = False
        self._stop_level: np.ndarray | None = None
        self._lost = False
        self._anchor: np.ndarray | None = None
        self._settled = False

    @property
    def known(self) -> np.ndarray:
        """(A,): the accelerometers whose static output is known well enough to subtract it."""
        return self._rested[::3] >= 2 * self.conditioning.trigger_blocks

    @property
    def subtracted(self) -> np.ndarray:
        """(C,) V: the last block less the static output."""
        return self._recent[-1] - self.static

    @property
    def moved(self) -> bool:
        """Whether the signal has gone on changing since the trigger, as a slide's does and a touch's does not."""
        return self._moved

    def push(self, block: np.ndarray, healthy: np.ndarray | None = None) -> None:
        """Takes one block's mean (C,) V. healthy: (A,) bool, None: all.

        An accelerometer that is not healthy leaves the slide at hand, and comes back once its static output is
        known anew. When none is left the slide is forgotten, and no other begins before the output is back at
        what was known, or has stood still for long: something may have come to rest on the skin meanwhile.
        """
        dead = None if healthy is None or all(healthy.tolist()) else np.repeat(~healthy, 3)
        if dead is not None:
            self._drop(dead)
        oldest = self._recent[0].copy()
        self._recent[:-1] = self._recent[1:]
        self._recent[-1] = block
        if self.state is State.SLIDE:
            self._extend(block)
            self._watch_motion()
            if self.state is State.SLIDE and self._blocks >= 2 * self.conditioning.least_blocks:
                self._watch_end()
            return
        memory = len(self._recent)
        if self._settled and self._follow(oldest):
            return
        self._filled += 1
        if dead is not None:
            self._filled[dead] = 0
        ready = (self._filled >= memory) & (self._rested >= 2 * memory)
        distance = np.abs(self._level() - (self.static if self._stop_level is None else self._stop_level))
        away = distance > self.conditioning.trigger_v
        if self._lost:
            self._find_rest(ready & ~away)
        elif (away & ready)[self.tilt].any():
            self._begin(ready)
        elif self._stop_level is None:
            resting = self._filled > memory
            self._rested += resting
            # The first rise of a slow slide must not pass for drift of the zero, or the zero runs after it.
            calm = distance <= self.conditioning.calm_v
            pace = np.where(calm | (self._rested < 10 * memory), 1.0, 0.1)
            step = (
                pace
                * (oldest - self.static)
                / np.minimum(np.maximum(self._rested, 1), self.conditioning.rest_blocks)
            )
            self.static += np.where(resting, step, 0.0)
            self._settled = bool((resting & (self._rested >= self._most_rested)).all())
        else:
            self._stopped += 1
            if self._stopped > self.conditioning.longest_blocks:
                self._learn_static()

    def window(self) -> Window | None:
        """The slide so far in equal bins; the last one when it has ended; else None."""
        if self.state is not State.SLIDE:
            return self.final
        if self._blocks < self.conditioning.least_blocks:
            return None
        return self._window(self._blocks)

    def _level(self) -> np.ndarray:
        """(C,) V: mean of the last `trigger_blocks` blocks."""
        return np.add.reduce(self._recent, axis=0) / len(self._recent)

    def _follow(self, oldest: np.ndarray) -> bool:
        """A quiet block of a stream at rest for so long that there is nothing left to count."""
        if max(map(abs, (self._level() - self.static).tolist())) > self._quiet_v:
            return False
        self.static += (oldest - self.static) / self.conditioning.rest_blocks
        return True

    def _drop(self, dead: np.ndarray) -> None:
        """Takes the accelerometers of the dead channels (C,) out of use."""
        self._settled = False
        if dead.all():
            self._lost = bool(self.known.any())
            self._anchor, self._stood = None, 0
            self.state, self.final, self._moved = State.REST, None, False
            self._stop_level = None
            return
        self._rested[dead] = 0
        if self.state is State.SLIDE:
            self.usable = self.usable & ~dead[::3]
            self._watched = self.tilt[self.usable[self.tilt // 3]]
            if not self.usable.any():
                self.reset()

    def _find_rest(self, near: np.ndarray) -> None:
        """Ends the search for the static output; near: (C,), whether a channel is back at it."""
        if near[self.tilt].all():
            self._lost = False
            return
        level = self._level()[self.tilt]
        if self._anchor is None or np.abs(level - self._anchor).max() > self.conditioning.release_v:
            self._anchor, self._stood = level, 0
        self._stood += 1
        if self._stood > LOST_BLOCKS:
            self._learn_static()

    def _begin(self, ready: np.ndarray) -> None:
        self._before = (self.state, self.usable, self._moved)
        self.state = State.SLIDE
        self.usable = ready[::3]
        self._watched = self.tilt[self.usable[self.tilt // 3]]
        self._moved = False
        self._touched: np.ndarray | None = None
        self._blocks = 0
        self._stride = 1
        self._peak = 0.0
        self._knots = 0
        self._sum = np.zeros(len(self.static))
        self._crept = np.zeros(len(self.static))
        self._integral[:, 0] = 0.0
        self._stop_level = None
        for block in self._recent:
            self._extend(block)
        self._filled[:] = 0
        self._settled = False

    def _extend(self, block: np.ndarray) -> None:
        subtracted = block - self.static
        self._sum += subtracted
        so_far = self._sum
        if self._lag_blocks:
            self._crept += self._creep * (subtracted - self._crept)
            so_far = so_far + self._lag_blocks * self._crept
        self._peak = max(self._peak, *map(abs, subtracted[self._watched].tolist()))
        self._blocks += 1
        if self._blocks % self._stride == 0:
            self._knots += 1
            self._integral[:, self._knots] = so_far
            if self._knots == KNOTS:
                self._integral[:, : KNOTS // 2 + 1] = self._integral[:, : KNOTS + 1 : 2]
                self._knots //= 2
                self._stride *= 2
        # Behind the last knot the integral as it stands.
        self._integral[:, self._knots + 1] = so_far

    def _integral_at(self, blocks: np.ndarray) -> np.ndarray:
        """Integral of the subtracted output (V blocks) at block counts (m,) since the trigger -> (C, m)."""
        place = blocks / self._stride
        below = np.minimum(place.astype(np.intp), self._knots)
        share = place - below
        # From the last knot it is not a whole stride to the integral as it stands.
        share[below == self._knots] *= self._stride / max(self._blocks - self._stride * self._knots, 1)
        low = self._integral.take(below, axis=1)
        return low + share * (self._integral.take(below + 1, axis=1) - low)

    def _window(self, blocks: int) -> Window:
        integral = self._integral_at(EDGES * (blocks / WINDOW_BINS))
        means = (integral[:, 1:] - integral[:, :-1]) * (WINDOW_BINS / blocks)
        if not all(self.usable.tolist()):
            means[np.repeat(~self.usable, 3)] = 0.0
        return Window(means.astype(np.float32), blocks * self.conditioning.block_s)

    def _watch_motion(self) -> None:
        """Notes when the signal has changed beyond what it showed `touch_blocks` after the trigger.

        A strong signal that has not by four times as long is a touch; a slow slide's signal is weak by then.
        """
        c = self.conditioning
        if self._moved or self._blocks < c.touch_blocks:
            return
        level = self._level()[self._watched] - self.static[self._watched]
        if self._touched is None or len(self._touched) != len(level):
            self._touched = level
        # Pressing harder and lifting off scale every output alike; neither is motion over the skin.
        scaled = self._touched * max(level @ self._touched / (self._touched @ self._touched), 0.0)
        change = np.abs(level - scaled).max()
        self._moved = bool(change > max(TOUCH_TRIGGER * c.trigger_v, TOUCH_CHANGE * self._peak))
        strong = np.abs(self._touched).max() > TOUCH_TRIGGERS * c.trigger_v
        if not self._moved and strong and self._blocks >= 4 * c.touch_blocks:
            self._end(self._blocks, self._level() - self.static)

    def _watch_end(self) -> None:
        """Ends the slide when the contact has left the dome, or has come to a stop on it."""
        c = self.conditioning
        if self._blocks > c.longest_blocks:
            self.reset()
            return
        span = max(2 * c.trigger_blocks, int(c.still_share * self._blocks))
        if self._blocks % max(1, span // 8) or span > self._blocks // 2:
            return
        # Four quarters, not two halves: over an extreme, halves agree by symmetry while the contact moves on.
        quarter = span // 4
        marks = self._integral_at(self._blocks - quarter * QUARTERS)
        levels = (marks[:, 1:] - marks[:, :-1]) / quarter
        levels = levels[self._watched]
        # The output itself creeps after what its history shows; until it is back, it would begin a slide of its own.
        level = self._level() - self.static
        if max(np.abs(levels[:, 2:]).max(), np.abs(level[self._watched]).max()) < c.release_v:
            self._end(self._blocks, None)
        elif self._peak > c.still_peak_v and np.ptp(levels, axis=1).max() < c.still_change * self._peak:
            self._end(self._blocks - 4 * quarter, level)

    def _end(self, blocks: int, level: np.ndarray | None) -> None:
        """Ends the slide with its first `blocks`; level: (C,) V subtracted output at the stop, None: released."""
        if self._moved:
            self.final = self._window(max(blocks, self.conditioning.least_blocks))
            self.state = State.ENDED
        else:
            jump = level is not None and self._jumped(level)
            self.state, self.usable, self._moved = self._before
            if jump:
                self._learn_static()
                return
        self._stop_level = None if level is None else level + self.static
        self._stopped = 0

    def _jumped(self, level: np.ndarray) -> bool:
        """Whether the output went to `level` (C,) V within a block: a zero does, a hand does not."""
        if self._stride > 1:
            return False
        blocks = np.diff(self._integral[self._watched, : self.conditioning.touch_blocks + 1])
        level = level[self._watched]
        share = level @ blocks / (level @ level)
        return bool(np.sum(np.abs(share - 0.5) < 0.35) <= 1)

    def _learn_static(self) -> None:
        """Awaits a new static output."""
        self._settled = False
        self._rested[:] = 0
        self._filled[:] = 0
        self._stop_level = None
        self._lost = False


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

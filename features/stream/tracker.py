"""The state machine of one stream: rest, slide, end of the slide. Everything is decided a block at a time.

A trigger begins a slide; its end is a release (the contact has left) or a stop (it stands still on the skin). What has
only changed in strength since the trigger is a touch, something set down, pressed or lifted off: after it the tracker
is back where it was before.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.stream.conditioning import ONSETS, Conditioning
from softslide.features.stream.slide_history import SlideHistory
from softslide.features.stream.static_output import StaticOutput
from softslide.features.window import Window

# The V_x and V_y of a slide change in more than their common strength, and by more than either of these: a share of the
# largest output so far, and of the trigger (five times the noise of a mean over `trigger_blocks`). With half of either,
# nearly twice as many presses pass for slides (experiments/LOG.md, of this and the constants below).
TOUCH_CHANGE = 0.06
TOUCH_TRIGGER = 0.5
# A signal that is this many times the trigger `touch_blocks` after it, and has not moved by this many times
# `touch_blocks`, is a touch. A weaker one may still be a slow slide.
STRONG_TRIGGERS = 4.0
STRONG_TOUCH = 4
# A jump of the zero is complete within a block: of the first blocks at most one lies this close to half of the final
# level, as a share of it, and the last lies beyond.
JUMP_SHARE = 0.35
# A contact has come down in the first block that shows more than this share of what the trigger's blocks show at most.
TOUCHED_SHARE = 0.3


class SlideState(StrEnum):
    """What the stream shows: nothing so far, a slide, or the end of one."""

    REST = "rest"
    SLIDE = "slide"
    ENDED = "ended"


class EndedSlide(NamedTuple):
    """The last slide: its window, the accelerometers (A,) that it was read from, and for how many blocks the contact
    had stopped when that was noticed, 0 if it was released."""

    window: Window
    usable: np.ndarray
    rested: int


class SlideTracker:
    """One stream's tracker.

    touch: indices of the channels that answer to a touch, the only ones that trigger and release.
    """

    def __init__(self, conditioning: Conditioning, channels: int) -> None:
        self.conditioning = conditioning
        self.touch = touch_channels(channels, conditioning.touch_axes)
        self.static_output = StaticOutput(conditioning, channels)
        self._every = np.ones(channels // 3, dtype=bool)
        self._recent = np.zeros((conditioning.trigger_blocks, channels))
        self._slide: SlideHistory | None = None
        # Of the slide at hand: the subtracted output `touch_blocks` after its trigger; whether it has changed since.
        self._touch_v: np.ndarray | None = None
        self._moved = False
        self._last: EndedSlide | None = None
        # Where a contact has stopped, the output there takes the static output's place until the next trigger.
        self._stop_v: np.ndarray | None = None
        self._stopped_blocks = 0
        self._from_stop = False

    def reset(self) -> None:
        """Back to an unknown static output."""
        self.static_output = StaticOutput(self.conditioning, 3 * len(self._every))
        self._slide = self._last = self._stop_v = None

    @property
    def state(self) -> SlideState:
        """What the stream shows now."""
        if self._slide is not None:
            return SlideState.SLIDE
        return SlideState.REST if self._last is None else SlideState.ENDED

    @property
    def static(self) -> np.ndarray:
        """(C,) V: the static output."""
        return self.static_output.volts

    @property
    def known(self) -> np.ndarray:
        """(A,): the accelerometers whose static output is known well enough to subtract it."""
        return self.static_output.known

    @property
    def subtracted(self) -> np.ndarray:
        """(C,) V: the last block less the static output."""
        return self._recent[-1] - self.static

    @property
    def subtracted_level(self) -> np.ndarray:
        """(C,) V: mean of the last `trigger_blocks` blocks less the static output."""
        return self._level() - self.static

    @property
    def usable(self) -> np.ndarray:
        """(A,): the accelerometers that the slide at hand, or else the last one, is read from."""
        slide = self._slide or self._last
        return self._every if slide is None else slide.usable

    @property
    def moved(self) -> bool:
        """Whether the signal has gone on changing since the trigger, as a slide's does and a touch's does not."""
        return self._last is not None if self._slide is None else self._moved

    @property
    def final(self) -> Window | None:
        """The last slide that has ended."""
        return None if self._last is None else self._last.window

    @property
    def rested_s(self) -> float:
        """For how long the contact of the last slide had stopped when that was noticed; 0 if it was released, and while
        the next slide runs."""
        if self._last is None or self._slide is not None:
            return 0.0
        return self._last.rested * self.conditioning.block_s

    def window(self) -> Window | None:
        """The slide so far in equal bins; the last one when it has ended; else None."""
        if self._slide is None:
            return self.final
        if self._slide.blocks < self.conditioning.least_blocks:
            return None
        return self._slide.window(self._slide.blocks)

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
        if self._slide is None:
            self._rest(oldest, dead)
            return
        self._slide.push(block)
        self._judge_motion(self._slide)
        if self._slide is not None and self._slide.blocks >= 2 * self.conditioning.least_blocks:
            self._judge_end(self._slide)

    def _level(self) -> np.ndarray:
        """(C,) V: mean of the last `trigger_blocks` blocks."""
        return np.add.reduce(self._recent, axis=0) / len(self._recent)

    def _drop(self, dead: np.ndarray) -> None:
        """Takes the accelerometers of the dead channels (C,) out of use."""
        if dead.all():
            self.static_output.lose()
            self._slide = self._last = self._stop_v = None
            return
        self.static_output.drop(dead)
        if self._slide is not None:
            self._slide.leave_out(dead)
            if not self._slide.usable.any():
                self.reset()

    def _rest(self, oldest: np.ndarray, dead: np.ndarray | None) -> None:
        """A block while nothing slides: triggers a slide, or follows the static output."""
        static, level = self.static_output, self._level()
        if static.follow_quiet(level, oldest):
            return
        static.count(dead)
        ready = static.ready
        distance = np.abs(level - (static.volts if self._stop_v is None else self._stop_v))
        away = distance > self.conditioning.trigger_v
        if static.searching:
            if static.search(level, ready & ~away):
                self._learn_static()
        elif static.moves(away):
            static.begin_again()
        elif (away & ready)[self.touch].any():
            self._begin(ready[::3])
        elif self._stop_v is None:
            static.follow(oldest, level, distance)
        else:
            self._stopped_blocks += 1
            if self._stopped_blocks > self.conditioning.longest_blocks:
                self._learn_static()

    def _begin(self, usable: np.ndarray) -> None:
        """A slide begins with the blocks that triggered it. usable: (A,)."""
        self._slide = SlideHistory(self.conditioning, self.static, usable)
        self._touch_v, self._moved = None, False
        self._from_stop = self._stop_v is not None
        self._stop_v = None
        for block in self._recent if self.conditioning.onset == ONSETS[0] else self._after_jump():
            self._slide.push(block)
        self.static_output.hold()

    def _after_jump(self) -> np.ndarray:
        """(n, C) V: the last blocks after the one in which a contact came down; none if that is the newest."""
        distance = np.abs(self._recent - self.static)[:, self.touch].max(axis=1)
        came_down = int((distance > TOUCHED_SHARE * distance.max()).argmax())
        return self._recent[came_down + 1 :]

    def _judge_motion(self, slide: SlideHistory) -> None:
        """Notes when the signal has changed in shape since `touch_blocks`; ends what is strong and never does."""
        c = self.conditioning
        if self._moved or slide.blocks < c.touch_blocks:
            return
        level = self._level()[slide.watched] - slide.static_v[slide.watched]
        if self._touch_v is None or len(self._touch_v) != len(level):
            self._touch_v = level
        # Pressing harder and lifting off scale every output alike; neither is motion over the skin.
        scaled = self._touch_v * max(level @ self._touch_v / (self._touch_v @ self._touch_v), 0.0)
        change = np.abs(level - scaled).max()
        self._moved = bool(change > max(TOUCH_TRIGGER * c.trigger_v, TOUCH_CHANGE * slide.peak_v))
        strong = np.abs(self._touch_v).max() > STRONG_TRIGGERS * c.trigger_v
        if not self._moved and strong and slide.blocks >= STRONG_TOUCH * c.touch_blocks:
            self._end(slide, slide.blocks, self.subtracted_level)

    def _judge_end(self, slide: SlideHistory) -> None:
        """Ends the slide when the contact has left the skin, or has come to a stop on it."""
        c = self.conditioning
        if slide.blocks > c.longest_blocks:
            self.reset()
            return
        span = max(2 * c.trigger_blocks, int(c.still_share * slide.blocks))
        # Looked at eight times a span only.
        if slide.blocks % max(1, span // 8) or span > slide.blocks // 2:
            return
        # Four quarters, not two halves: over an extreme, halves agree by symmetry while the contact moves on.
        quarter = span // 4
        means = slide.last_quarters(quarter)
        # The output itself creeps after what its history shows; until it is back, it would begin a slide of its own.
        level = self.subtracted_level
        if max(np.abs(means[:, 2:]).max(), np.abs(level[slide.watched]).max()) < c.release_v:
            self._end(slide, slide.blocks if c.onset == ONSETS[0] else slide.shown_blocks - 1, None)
        elif slide.peak_v > c.still_peak_v and np.ptp(means, axis=1).max() < c.still_change * slide.peak_v:
            self._end(slide, slide.blocks - 4 * quarter, level)

    def _end(self, slide: SlideHistory, blocks: int, level: np.ndarray | None) -> None:
        """Ends the slide with its first `blocks`; level: (C,) V subtracted output at the stop, None: released.

        After a touch all is as before it, but that a jump of the zero is a new static output.
        """
        self._slide = None
        if self._moved:
            window = slide.window(max(blocks, self.conditioning.least_blocks))
            self._last = EndedSlide(window, slide.usable, 0 if level is None else slide.blocks - blocks)
        elif level is not None and not self._from_stop and self._jumped(slide, level):
            self._learn_static()
            return
        self._stop_v = None if level is None else level + self.static
        self._stopped_blocks = 0

    def _jumped(self, slide: SlideHistory, level: np.ndarray) -> bool:
        """Whether the output went to `level` (C,) V within a block: a zero does, a hand does not."""
        blocks = slide.first_blocks(self.conditioning.touch_blocks)
        if blocks is None:
            return False
        level = level[slide.watched]
        share = level @ blocks / (level @ level)
        between = np.abs(share - 0.5) < JUMP_SHARE
        return bool(share[-1] >= 0.5 + JUMP_SHARE and between.sum() <= 1)

    def _learn_static(self) -> None:
        """Awaits a new static output."""
        self.static_output.learn_anew()
        self._stop_v = None


def track(blocks: np.ndarray, conditioning: Conditioning, read_at: np.ndarray) -> list[Window | None]:
    """The window as it stood after each of the block counts in `read_at` (ascending), the batch form.

    blocks: (m, C) V, means from `block_means`; read_at: (k,) numbers of blocks seen.
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

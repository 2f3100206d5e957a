"""The static output: what each channel shows while nothing touches the skin, followed for as long as nothing does."""

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.stream.conditioning import Conditioning

# The first estimate is a plain mean over this many times `trigger_blocks`, 0.2 s: its noise is then 1 / sqrt(2) of that
# of the mean which is compared with it.
KNOWN_MEMORIES = 2
# Up to this many times `trigger_blocks`, 1 s, the estimate follows everything: it may have begun on something wrong.
LEARNING_MEMORIES = 10
# A stream may begin in mid-contact. While the first estimate follows everything, a trigger within this many times
# `trigger_blocks`, 0.4 s, or after the estimate itself has moved by this share of the trigger (four standard deviations
# of its noise, half of what a steady slope moves it by), is the contact that was there before, and no slide from rest.
PROVEN_MEMORIES = 4
MOVED_SHARE = 0.5
# After that the signal has to rest for this many times `trigger_blocks`, 0.6 s: longer than a slide's extrema seem to.
RESTED_MEMORIES = 6
# Pace for a mean beyond `calm_v`. A slide of 0.5 mm/s takes seconds to reach the trigger; with the full pace the static
# output rose with it by 15 mV (experiments/LOG.md).
SLOW_PACE = 0.1
# Blocks, 6 s, that a stream has to stand still after a loss for its output to be taken for the static one. A contact
# that rests on the skin for longer cannot be distinguished from a shifted zero.
SEARCH_BLOCKS = 300


class StaticOutput:
    """One stream's static output.

    The average is of blocks that have left the trigger's mean: what is about to trigger has not entered it yet.

    volts: (C,) V. searching: whether every accelerometer was lost, and rest has not been found again.
    """

    def __init__(self, conditioning: Conditioning, channels: int) -> None:
        self._conditioning = conditioning
        self._memory = conditioning.trigger_blocks
        self._touch = touch_channels(channels, conditioning.touch_axes)
        self._quiet_v = min(conditioning.calm_v, conditioning.trigger_v)
        self._most_counted = max(conditioning.rest_blocks, LEARNING_MEMORIES * self._memory)
        self.volts = np.zeros(channels)
        self.searching = False
        # Averaged blocks after which an output is known; more after a beginning in mid-contact.
        self._enough = KNOWN_MEMORIES * self._memory
        # (C,) V: the level as the average began.
        self._begun_v = np.zeros(channels)
        # (C,) blocks in the average, and blocks in a row that the trigger's mean may be taken from.
        self._averaged = np.zeros(channels)
        self._available = np.zeros(channels)
        self._settled = False
        self._anchor_v: np.ndarray | None = None
        self._still_blocks = 0

    @property
    def known(self) -> np.ndarray:
        """(A,): the accelerometers whose static output is known well enough to subtract it."""
        return self._averaged[::3] >= self._enough

    @property
    def rested_blocks(self) -> np.ndarray:
        """(A,): how many blocks it is learned from, as long as they are counted."""
        return self._averaged[::3]

    @property
    def ready(self) -> np.ndarray:
        """(C,): the channels that may trigger: the static output is known and the last blocks were healthy."""
        return (self._available >= self._memory) & (self._averaged >= self._enough)

    def follow_quiet(self, level_v: np.ndarray, oldest: np.ndarray) -> bool:
        """The short way of a stream that has rested for so long that counting changes nothing; False: not to be taken.

        level_v: (C,) V, mean of the last `trigger_blocks` blocks; oldest: (C,) V, the block that has left it.
        """
        if not self._settled or max(map(abs, (level_v - self.volts).tolist())) > self._quiet_v:
            return False
        self.volts += (oldest - self.volts) / self._conditioning.rest_blocks
        return True

    def count(self, dead: np.ndarray | None) -> None:
        """Counts a block at rest. dead: (C,), the channels that it says nothing of; None: none."""
        self._available += 1
        if dead is not None:
            self._available[dead] = 0

    def moves(self, away: np.ndarray) -> bool:
        """Whether the signal moved while the static output was learned: the stream began in mid-contact.

        away: (C,), the channels whose level is beyond the trigger.
        """
        counted = self._averaged[self._touch]
        away = away[self._touch] & (counted > 0)
        if not away.any() or (counted[away] >= LEARNING_MEMORIES * self._memory).any():
            return False
        early = counted < max(PROVEN_MEMORIES * self._memory, self._enough)
        shift_v = np.abs(self.volts - self._begun_v)[self._touch]
        return bool((early | (shift_v > MOVED_SHARE * self._conditioning.trigger_v))[away].any())

    def begin_again(self) -> None:
        """Awaits a new static output, which has to rest for longer than the first."""
        self.learn_anew()
        self._enough = RESTED_MEMORIES * self._memory

    def follow(self, oldest: np.ndarray, level_v: np.ndarray, distance_v: np.ndarray) -> None:
        """A mean at first, then an exponential average over `rest_blocks`.

        oldest: (C,) V, the block that has left the trigger's mean; level_v: (C,) V, that mean; distance_v: (C,) V, of
        it from `volts`.
        """
        resting = self._available > self._memory
        self._begun_v = np.where(self._averaged == 0, level_v, self._begun_v)
        self._averaged += resting
        # The first rise of a slow slide must not pass for drift, or the static output runs after it.
        calm = distance_v <= self._conditioning.calm_v
        pace = np.where(calm | (self._averaged < LEARNING_MEMORIES * self._memory), 1.0, SLOW_PACE)
        blocks = np.minimum(np.maximum(self._averaged, 1), self._conditioning.rest_blocks)
        self.volts += np.where(resting, pace * (oldest - self.volts) / blocks, 0.0)
        self._settled = bool((resting & (self._averaged >= self._most_counted)).all())

    def hold(self) -> None:
        """Stays as it is while something touches; blocks are counted anew after that."""
        self._available[:] = 0
        self._settled = False

    def drop(self, dead: np.ndarray) -> None:
        """Forgets the static output of the dead channels (C,)."""
        self._averaged[dead] = 0
        self._settled = False

    def lose(self) -> None:
        """No accelerometer is left. Something may come to rest on the skin before one is back: rest is searched for."""
        self.searching = bool(self.known.any())
        self._anchor_v, self._still_blocks = None, 0
        self._settled = False

    def search(self, level_v: np.ndarray, near: np.ndarray) -> bool:
        """Whether the stream has stood still elsewhere for so long that its static output is to be learned anew.

        level_v: (C,) V, mean of the last blocks. near: (C,), whether it is back at the static output; that ends the
        search.
        """
        if near[self._touch].all():
            self.searching = False
            return False
        level_v = level_v[self._touch]
        if self._anchor_v is None or np.abs(level_v - self._anchor_v).max() > self._conditioning.release_v:
            self._anchor_v, self._still_blocks = level_v, 0
        self._still_blocks += 1
        return self._still_blocks > SEARCH_BLOCKS

    def learn_anew(self) -> None:
        """Awaits a new static output."""
        self._averaged[:] = 0
        self._available[:] = 0
        self._settled = self.searching = False

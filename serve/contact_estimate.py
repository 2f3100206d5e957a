"""The estimate of a contact: the straight slide that the graph fits, the track, or neither, and why.

1. The straight slide, where the track agrees with it (`apart`), and is valid or makes it likely (`likely`). On a line
   that they agreed on before, its misfit may be twice the bundle's limit, where a valid track agrees to 95 %.
2. What the signal forbids, whatever fits: a dead channel, drift; too early, unless the track has much evidence.
3. The line that straight slide and track agreed on, where the contact stops on it, or where the straight slide still
   follows it and the track is lost or goes much the same way: then with intervals that hold the track.
4. Ambiguous, where a straight slide explains the output and goes another way than the track, or explains to the noise
   what the track takes for a press.
5. The track, valid by its own limits (`features/track_estimate.py`).

A model on features answers by itself: the track allows its estimate or forbids it.
"""

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softslide.features.card import Card
from softslide.features.contact.replay import ReplayingTracker
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.track import Track
from softslide.features.contact.tracker import ContactTracker
from softslide.features.contact.tracking_config import TOUCH_DOWN, TrackingConfig
from softslide.features.estimate import Contact, Estimate, Reason
from softslide.features.straight_slide import (
    PAUSE_S,
    STOPPING_S,
    apart,
    crosses,
    earlier,
    explains,
    likely,
    same_line,
    stopped_on,
    stops_on,
    straight_fit,
    with_track,
)
from softslide.features.stream.conditioning import ONSETS, LagUndone
from softslide.features.stream.tracker import SlideState, SlideTracker
from softslide.features.track_estimate import LIKELY, TOUCH_LIMITS, TrackLimits, is_sure, judged

# Blocks, 0.1 s, between two straight fits that are kept, and 0.2 s between two that the tracker is offered.
FIT_BLOCKS, OFFER_BLOCKS = 5, 10
# A straight slide is fitted anew when the slide has grown by one part in so many: with a twentieth fast slides erred
# half as much again at 2/5 of the stroke (experiments/LOG.md).
NEW_SHARE = 50
# Fits, 0.3 s, that a stop takes to show in the track, at most (synthetic slides, experiments/LOG.md).
KEPT_FITS = 4
# Times the bundle's limit: the largest misfit of a straight slide of the line so far, where a track errs twice as much
# (experiments/LOG.md).
LINE_MISFIT = 2.0
# Misfit of a slide that explains the output to the noise: of a press a straight slide has more, once it rests.
TO_NOISE = 1.0
# What forbids any estimate from the signal, not only that of a straight slide.
_OF_THE_SIGNAL = (Reason.DEAD_CHANNEL, Reason.DRIFT, Reason.TOO_EARLY)


class _Fit(NamedTuple):
    """A straight slide, and after how many blocks it was fitted."""

    blocks: int
    estimate: Estimate


class ContactEstimator:
    """Follows one stream's contacts; of a bundle that knows straight slides alone it follows none.

    stream: what it reads of the stream: its state, static output and last block. lag_blocks: how far back `past` reads.
    """

    def __init__(self, card: Card, stream: SlideTracker, lag_blocks: int) -> None:
        self._card, self._stream, self._lag_blocks = card, stream, lag_blocks
        self._lag = LagUndone(card.conditioning, len(stream.touch))
        self.touches_down = card.conditioning.onset == ONSETS[1]
        self._tracker = self._made(math.nan)
        self._step = 0  # of the skin's height that it is for
        self._on_features = card.input == "features"
        self._limits = TOUCH_LIMITS if self.touches_down else TrackLimits()
        self._strict = replace(self._limits, sure_log_odds=math.inf)
        self._count = 0
        # The last straight slide that was fitted, and the last ones that the track agreed with: the newest of a contact
        # that stops is of some of the stop.
        self._fit: _Fit | None = None
        self._lines: deque[_Fit] = deque(maxlen=KEPT_FITS)
        self.reset()

    def reset(self) -> None:
        """Forgets the contact."""
        self._lag.reset()
        self.track: Track | None = None
        # The track when the output was last above the trigger, and after how many blocks that was: below it, at the
        # skin's rim, a track wanders, and does not show whether a slide was straight.
        self._clear: tuple[Track, int] | None = None
        self.begin()
        if self._tracker is not None:
            self._tracker.reset()

    def begin(self) -> None:
        """A slide begins: fits of the one before are not of it."""
        self._fit = None
        self._lines.clear()

    def read_at(self, step: int, step_mm: float) -> None:
        """Reads the map at a skin's height so many steps off the card's.

        It is mixed anew for that, which takes a millisecond: not in mid-contact, and not for nothing.
        """
        if self.track is None and step != self._step:
            assert self._card.heights is not None
            self._tracker, self._step = self._made(self._card.heights.height_mm + step * step_mm), step

    def follow(self, healthy: np.ndarray, count: int) -> None:
        """Takes the stream's last block. healthy: (A,) accelerometers in it; count: of blocks so far."""
        self._count = count
        stream, conditioning = self._stream, self._card.conditioning
        if self._tracker is None:
            return
        if not any(stream.known.tolist()):
            self.reset()
            return
        volts = self._lag.push(stream.subtracted[stream.touch])
        usable = np.repeat(stream.usable & healthy, len(conditioning.touch_axes))
        self.track = self._tracker.push(volts, stream.state is SlideState.SLIDE, usable)
        if self.track is None:
            self._clear = None
        elif np.abs(stream.subtracted_level[stream.touch][usable]).max(initial=0.0) > conditioning.trigger_v:
            self._clear = self.track, count

    @property
    def wants_fit(self) -> bool:
        """Whether `take_fit` would make use of a straight slide."""
        return self.track is not None and not self.touches_down

    def latest_fit(self, blocks: int) -> Estimate | None:
        """The straight slide that was fitted last, moved on to now; None where a new one is due.

        blocks: of the slide so far; what a fiftieth of them adds changes a fit by less than its error.
        """
        stretch = max(1, blocks // NEW_SHARE)
        if self._fit is None or not self.wants_fit or self._count - self._fit.blocks >= stretch:
            return None
        return earlier(self._fit.estimate, -self._seconds_since(self._fit.blocks))

    def take_fit(self, fitted: Estimate, straight: Estimate, elapsed_s: float) -> None:
        """Keeps a straight slide, fitted to so many s, and offers it to the tracker where that has lost the contact.

        straight: what the signal permits of it.
        """
        assert self.track is not None
        self._fit = _Fit(self._count, fitted)
        if not straight.valid:
            return
        tracked = self._judged(self.track, 0.0)
        if self._on_features:
            if min(tracked.speed_lo_mm_s, straight.speed_lo_mm_s) > 0.0 and same_line(straight, tracked):
                self._lines.append(self._fit)
            return
        if self._agrees(straight, tracked):
            self._lines.append(self._fit)
        elif (
            self._count % OFFER_BLOCKS == 0
            and explains(straight)
            and not tracked.valid
            and self._apart(straight) > self._limits.agreement
        ):
            assert self._tracker is not None
            assert self._card.contact is not None
            self._tracker.offer(straight_fit(straight, elapsed_s, self._card.contact.depth_mm))

    def estimate(self, straight: Estimate | None, time_s: float, healthy: bool) -> Estimate | None:
        """What is said of the contact now; None: what is said of the straight slide, if there is one.

        healthy: whether any accelerometer is.
        """
        state, limits = self._stream.state, self._limits
        # Where contacts are lifted anywhere, the whole slide says more than the track of it.
        of_all = self.touches_down and straight is not None and state is not SlideState.SLIDE
        if self.track is None or of_all:
            return None
        tracked = self._judged(self.track, time_s)
        if self._on_features:
            return self._allowed(straight, tracked)
        # A press needs no way, and no slide.
        pressed = tracked.valid and tracked.contact is Contact.PRESS
        if straight is None:
            if state is SlideState.SLIDE or pressed:
                return tracked
            return tracked._replace(valid=False, reason=Reason.TOO_EARLY if healthy else Reason.DEAD_CHANNEL)
        if tracked.valid and self._is_of_the_line(straight):
            straight = straight._replace(valid=True, reason=Reason.NONE)
        if straight.valid and self._stream.rested_s == 0.0 and self._agrees(straight, tracked):
            return with_track(straight, tracked, limits.shared)
        if straight.reason in _OF_THE_SIGNAL:
            # Where the output has not moved on since the touch, it may be a press's.
            sure = tracked.valid and is_sure(self.track, limits)
            if straight.reason is Reason.TOO_EARLY and (pressed or sure):
                return tracked
            return tracked._replace(valid=False, reason=straight.reason)
        if self.touches_down:
            return tracked
        if self._lines:
            stopped = self._on_the_line(straight, tracked)
            if straight.valid and same_line(straight, self._lines[0].estimate):
                # A track that has lost the contact says nothing against a line that it agreed with, nor does one that
                # is valid for its evidence alone or goes on along the line at another speed: what fits all of the way
                # so far knows more.
                contests = tracked.valid and self._judged(self.track, time_s, self._strict).valid
                slides = (
                    stopped is tracked and tracked.contact is Contact.SLIDE and self._stream.rested_s == 0.0
                )
                if not contests or (slides and not crosses(straight, tracked, limits)):
                    return with_track(straight, tracked, limits.shared)
            tracked = stopped
        turns = tracked.contact is Contact.SLIDE and crosses(straight, tracked, limits)
        if explains(straight) and (turns or (pressed and straight.misfit <= TO_NOISE)):
            return tracked._replace(valid=False, reason=Reason.AMBIGUOUS)
        return tracked

    def _apart(self, straight: Estimate) -> float:
        """How far a straight slide is from the track when the output was last above the trigger."""
        return apart(straight, *self._clear_track(), self._limits)

    def _agrees(self, straight: Estimate, tracked: Estimate) -> bool:
        """Whether the track agrees with a straight slide, and is valid or makes it likely."""
        return self._stands(self._apart(straight), tracked, self._clear_track()[0])

    def _stands(self, distance: float, tracked: Estimate, track: Track) -> bool:
        """Whether a straight slide stands at a distance from the track, which is valid or makes it likely."""
        return distance <= self._limits.agreement and (tracked.valid or likely(track, distance, self._limits))

    def _is_of_the_line(self, straight: Estimate) -> bool:
        """Whether a straight slide, its misfit over the bundle's limit, is of a line that the track agreed with and
        likely agrees with still."""
        return (
            straight.reason is Reason.NOT_THIS_SENSOR
            and straight.misfit <= LINE_MISFIT * self._card.validity.misfit
            and len(self._lines) > 0
            and same_line(straight, self._lines[0].estimate)
            and self._apart(straight) <= LIKELY
        )

    def _allowed(self, straight: Estimate | None, tracked: Estimate) -> Estimate | None:
        """Why the straight slide is not valid where the track has not been of its line a moment ago; else None."""
        if straight is None or not straight.valid:
            return None
        latest = self._stream.rested_s + STOPPING_S
        if self._lines and self._seconds_since(self._lines[-1].blocks) <= latest:
            return None
        return straight._replace(valid=False, reason=tracked.reason or Reason.AMBIGUOUS)

    def past(self, blocks: int) -> Track | None:
        """The track so many blocks ago, with what the tracker knows now; None where it follows another contact."""
        return None if self._tracker is None or not blocks else self._tracker.past(blocks)

    def in_hindsight(
        self, past: Track, time_s: float, now: Estimate | None, then: Estimate | None, blocks: int
    ) -> Estimate:
        """The straight slide of now, or of so many blocks ago, where the track of then agrees with it; else that."""
        limits, tracked = self._limits, self._judged(past, time_s)
        since = () if self.touches_down else ((now, blocks * self._card.conditioning.block_s), (then, 0.0))
        for line, since_s in since:
            if line is None or not line.valid:
                continue
            if self._stands(apart(line, past, since_s, limits), tracked, past):
                return with_track(earlier(line, since_s), tracked, limits.shared)
        return tracked

    def _on_the_line(self, straight: Estimate, tracked: Estimate) -> Estimate:
        """The track, or the line that it agreed with where the contact stops on it.

        Where the slide has ended with a stop, a fit of all before the stop says the most, if it is of the same line.
        """
        line = self._lines[0]
        since_s, rested_s = self._seconds_since(self._lines[-1].blocks), self._stream.rested_s
        ended = rested_s > 0.0 and since_s <= rested_s + STOPPING_S
        if ended and straight.valid and same_line(straight, line.estimate):
            # What was fitted ends where the contact rests.
            at_end = tracked._replace(x_mm=straight.x_mm, y_mm=straight.y_mm)
            return stopped_on(straight, at_end, ended)
        longest_mm = self._seconds_since(line.blocks) * line.estimate.speed_mm_s
        if ended or stops_on(line.estimate, tracked, since_s, longest_mm, self._limits):
            return stopped_on(line.estimate, tracked, ended or since_s > PAUSE_S)
        return tracked

    def _judged(self, track: Track, time_s: float, limits: TrackLimits | None = None) -> Estimate:
        card, state = self._card, self._stream.state
        assert card.contact is not None
        return judged(track, time_s, state, card.reference_mm, card.contact.depth_mm, limits or self._limits)

    def _clear_track(self) -> tuple[Track, float]:
        """The track when the output was last above the trigger, and how long ago that was, s."""
        assert self.track is not None
        clear, at = self._clear or (self.track, self._count)
        # The window ends as a contact is lifted that comes down anywhere, and so does its track.
        return clear, 0.0 if self.touches_down else self._seconds_since(at)

    def _seconds_since(self, blocks: int) -> float:
        return (self._count - blocks) * self._card.conditioning.block_s

    def _made(self, height_mm: float) -> ContactTracker | ReplayingTracker | None:
        """The tracker of the card's contacts. height_mm: of the skin, for a card over heights; NaN: the card's."""
        contact, heights = self._card.contact, self._card.heights
        if contact is None:
            return None
        splines = contact.splines()
        if heights is not None and not math.isnan(height_mm):
            splines[0] += (height_mm - heights.height_mm) * heights.splines(len(contact.noise_v))
        tracker = ContactTracker(
            ResponseSurface(splines, contact.half_mm, contact.spacing_mm),
            contact,
            self._card.conditioning,
            TOUCH_DOWN if self.touches_down else TrackingConfig(),
            self._lag_blocks,
        )
        # Where the only accelerometer fails, nothing is left to track with.
        return ReplayingTracker(tracker) if len(self._card.channels) > 3 else tracker

"""The runtime: load a bundle, push volts, read estimates. It needs numpy and ONNX Runtime alone."""

import math
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnxruntime as ort

from softslide.features.angles import touch_channels
from softslide.features.card import Card
from softslide.features.contact.track import Track
from softslide.features.departure import held_at_rim
from softslide.features.errors import InputError
from softslide.features.estimate import Contact, Estimate, Reason, decode
from softslide.features.force import ForceReader
from softslide.features.height import HEIGHT_INPUT, given_height
from softslide.features.stream.conditioning import Blocks
from softslide.features.stream.faults import (
    BRIDGED_BLOCKS,
    FROZEN_BLOCKS,
    Judged,
    SignalWatch,
    frozen_blocks,
    output_range,
)
from softslide.features.stream.gravity import GravityWatch
from softslide.features.stream.tracker import SlideState, SlideTracker
from softslide.features.vector.energy import energy_width_s
from softslide.features.vector.feature_vector import feature_vector
from softslide.features.window import WINDOW_BINS, Window
from softslide.serve.bundle import open_bundle
from softslide.serve.contact_estimate import FIT_BLOCKS, ContactEstimator
from softslide.serve.sample_slots import SampleClock, checked_samples
from softslide.serve.sensor_state import SensorState

# Largest share of a slide's blocks whose means may be old ones (features/stream/faults.py); above it none is valid.
BRIDGED_SHARE = 0.05
# Blocks, 1 s, between two readings of the sensor's state at rest; the static output's memory is 30 s.
DRIFT_BLOCKS = 50
# The tracker's map is of the skin's height rounded to this, 0.3 % of the response, and mixed anew for another one.
MAP_STEP_MM = 0.03
_OUTPUT = ["estimate"]
# With a lag: what forbids the estimate of its own moment and of those before it that are not given yet.
_OF_ANY_LAG = (
    *(Reason.DEAD_CHANNEL, Reason.DRIFT, Reason.STRENGTH, Reason.UNKNOWN_ZERO),
    *(Reason.ATTITUDE, Reason.SKIN_HEIGHT),
)
MOST_LAG_S = 2.0


class _Moment(NamedTuple):
    """What was estimated live, and the straight slide as it was then."""

    live: Estimate
    straight: Estimate | None


class Localizer:
    """The localizer of one stream. The same samples give the same estimates, whatever chunks they come in.

    A bad signal never raises. Samples that are not finite or outside the supply count as lost. Where too many are
    lost, or a channel is frozen, that accelerometer is left out, or the estimate is not valid where it was the only
    one. After that its static output is learned anew, which takes three times `trigger_blocks`.
    """

    def __init__(
        self,
        card: Card,
        session: ort.InferenceSession,
        height_mm: float | None = None,
        lag_s: float = 0.0,
    ) -> None:
        """height_mm: the skin's, for a bundle over heights; None: as the static output shows it. lag_s: s, at most
        MOST_LAG_S, in whole blocks: `push` gives each moment's estimate so much later, from the samples since as well.

        Raises:
            InputError: the bundle is for one height, or not for this one, or follows no contacts and so has no lag.
        """
        self._options, self._lag_blocks = (height_mm, lag_s), _lag_blocks(card, lag_s)
        self._moments: deque[_Moment] = deque()
        self.card = card
        self._sensor = SensorState(card, given_height(card.heights, height_mm))
        self._session = session
        channels, accelerometers = len(card.channels), card.sensor["accelerometers"]
        self._blocks = Blocks(len(card.columns), card.block_samples)
        self._clock = SampleClock(card.sample_rate_hz, round((BRIDGED_BLOCKS + 2) * card.block_samples))
        read = np.full(len(card.columns), card.input == "features")
        read[touch_channels(channels, card.conditioning.touch_axes)] = True
        # Without any of the base's outputs nothing is known.
        read[channels:] = True
        base = [] if card.base is None else [card.sensor["base"]]
        self._watch = SignalWatch(*output_range([*accelerometers, *base]), read, _frozen_blocks(card))
        self._tracker = SlideTracker(card.conditioning, channels)
        self._gravity = GravityWatch(accelerometers, card.conditioning)
        self._contact = ContactEstimator(card, self._tracker, self._lag_blocks)
        self._forces = None if card.force is None else ForceReader(card.force)
        self._inputs = {
            "volts": np.zeros((1, channels, WINDOW_BINS), np.float32),
            "elapsed_s": np.zeros(1, np.float32),
            "weight": np.ones((1, len(accelerometers)), np.float32),
        }
        if card.heights is not None:
            self._inputs[HEIGHT_INPUT] = np.zeros(1, np.float32)
        self.reset()

    @classmethod
    def load(
        cls,
        bundle: str | Path,
        height_mm: float | None = None,
        unsigned: bool = False,
        rate_hz: float | None = None,
        lag_s: float = 0.0,
    ) -> "Localizer":
        """Opens a bundle and checks the example of its card. height_mm, lag_s: as in `__init__`; unsigned: as in
        `read_card`; rate_hz: of the samples; None: as in its calibration.

        Raises:
            InputError: the bundle is missing, altered or truncated, does not give the result of its example, or is not
                for this height, rate or lag.
        """
        opened = cls(*open_bundle(bundle, unsigned), height_mm, lag_s)
        return opened if rate_hz is None else opened.at_rate(rate_hz)

    def at_rate(self, rate_hz: float) -> "Localizer":
        """This one, or a new one for samples at another rate, which is said on standard error.

        Raises:
            InputError: as `Card.at_rate`.
        """
        if rate_hz == self.card.sample_rate_hz:
            return self
        card = self.card.at_rate(rate_hz)
        print(
            f"samples at {rate_hz:.6g} Hz are read (calibrated at {self.card.sample_rate_hz:.6g} Hz)",
            file=sys.stderr,
        )
        return Localizer(card, self._session, *self._options)

    def reset(self) -> None:
        """Forgets the stream; the static output has to be learned anew."""
        self._blocks.reset()
        self._clock.reset()
        self._count = 0
        self._moments.clear()
        self.zero()

    def zero(self) -> None:
        """Learns the static output anew, while the stream goes on."""
        self._watch.reset()
        self._tracker.reset()
        self._sensor.reset()
        self._contact.reset()
        self._take_height(self._sensor.height_mm)
        self._bridged = 0
        self._slide_blocks = 0
        self._whole = True
        self._healthy = np.ones(len(self.card.channels) // 3, dtype=bool)
        self._bridging = ~self._healthy
        self._held: tuple[Window, Estimate] | None = None

    def feed(self, volts: np.ndarray, time_s: np.ndarray | None = None) -> None:
        """Takes samples as `push` does, without computing estimates."""
        for block in self._whole_blocks(volts, time_s):
            self._advance(*block)

    def push(self, volts: np.ndarray, time_s: np.ndarray | None = None) -> list[Estimate]:
        """Takes samples (n, C) V in the order of `Card.columns`; one estimate for each block that they complete.

        With a lag they are the estimates of the moments so long ago, first none; `rest` has the last ones.
        time_s: (n,) s, the samples' time stamps; None: each sample follows the one before. With stamps a lost sample
        leaves an empty slot. After a long gap, or when time runs back, the stream begins anew: estimates are not valid
        until the static output is known. The estimates' time_s is then of the stamps' clock.

        Raises:
            InputError: not real numbers, another shape, or a time that is not finite; no sample was taken.
        """
        return list(self.each(volts, time_s))

    def each(self, volts: np.ndarray, time_s: np.ndarray | None = None) -> Iterator[Estimate]:
        """As `push`, one by one and to be run to its end: what else is read in between is of the same moment."""
        for block in self._whole_blocks(volts, time_s):
            self._advance(*block)
            self._moments.append(now := self._now())
            if len(self._moments) > self._lag_blocks:
                yield self._in_hindsight(self._moments.popleft(), now)

    def rest(self) -> list[Estimate]:
        """At the end of a stream that is read with a lag, the estimates that `push` has not given yet."""
        left = []
        while self._moments:
            now = self._moments[-1]
            left.append(self._in_hindsight(self._moments.popleft(), now))
        return left

    def read(self) -> Estimate:
        """The estimate from the samples up to now, without a lag."""
        return self._now().live

    def _now(self) -> _Moment:
        tracker = self._tracker
        time_s = self._clock.start_s + self._count * self.card.conditioning.block_s
        if tracker.state is SlideState.ENDED:
            assert self._held is not None
            return _Moment(self._held[1]._replace(time_s=time_s), None)
        straight = self._contact.latest_fit(self._slide_blocks)
        if straight is None and (window := tracker.window()) is not None:
            straight = self._fitted(window)
        if straight is not None:
            straight = self._permitted(straight._replace(time_s=time_s))
        return _Moment(self._chosen(straight, time_s), straight)

    def _in_hindsight(self, then: _Moment, now: _Moment) -> Estimate:
        """A moment's estimate from the samples since as well, where the contact is still tracked.

        That is the straight slide of now or then, where the track of the moment agrees with it, else the track.
        """
        blocks = len(self._moments)
        past = self._contact.past(blocks)
        if past is None or then.live.reason in _OF_ANY_LAG:
            return then.live
        if now.live.reason in _OF_ANY_LAG:
            return then.live._replace(valid=False, reason=now.live.reason)
        tracked = self._contact.in_hindsight(past, then.live.time_s, now.straight, then.straight, blocks)
        return self._complete(tracked, past)._replace(
            time_s=then.live.time_s,
            state=then.live.state,
            misfit=then.live.misfit,
            accelerometers=now.live.accelerometers,
        )

    @property
    def blocks(self) -> int:
        """How many blocks of samples were complete since the stream began."""
        return self._count

    @property
    def state(self) -> SlideState:
        """What the stream shows now."""
        return self._tracker.state

    @property
    def subtracted(self) -> np.ndarray:
        """(C,) V: the last block's mean less the static output; NaN where the static output is not known."""
        known = np.repeat(self._tracker.known & self._healthy, 3)
        return np.where(known, self._tracker.subtracted / self.card.conditioning.scale, np.nan)

    @property
    def measured(self) -> bool:
        """Whether the last block's mean is of its own samples in every accelerometer, none of them faulty."""
        return bool((self._healthy & ~self._bridging).all())

    def window(self) -> Window | None:
        """The window of the slide so far, or else of the last one."""
        return self._tracker.window()

    def infer(self, inputs: dict[str, np.ndarray]) -> np.ndarray:
        """The graph's output (K,) for one window's inputs."""
        return self._session.run(_OUTPUT, inputs)[0][0]

    def inputs(self, window: Window) -> dict[str, np.ndarray]:
        """The graph's inputs for one window; the next call overwrites them."""
        if self.card.input == "features":
            return {"features": feature_vector(window.volts, window.elapsed_s)[None].astype(np.float32)}
        self._inputs["volts"][0] = window.volts
        self._inputs["elapsed_s"][0] = window.elapsed_s
        self._inputs["weight"][0] = self._tracker.usable
        return self._inputs

    def _fitted(self, window: Window) -> Estimate:
        """The graph's estimate: a straight slide at constant speed."""
        row = self.infer(self.inputs(window))
        width = math.nan
        if "log_speed_width" in self.card.outputs:
            width = float(energy_width_s(window.volts, np.asarray(window.elapsed_s)))
        return decode(row, self.card, window, self._tracker.state, 0.0, width)

    def _permitted(self, straight: Estimate) -> Estimate:
        """The straight slide, not valid where the signal forbids any."""
        tracker, reason = self._tracker, straight.reason
        if not (self._whole and (self.card.input == "window" or tracker.usable.all())):
            reason = Reason.DEAD_CHANNEL
        elif not self._gravity.kept:
            reason = Reason.DRIFT
        elif not tracker.moved:
            reason = Reason.TOO_EARLY
        return straight._replace(valid=reason is Reason.NONE, reason=reason)

    def _chosen(self, straight: Estimate | None, time_s: float) -> Estimate:
        """The straight slide or the track; what is common to both is added."""
        tracker = self._tracker
        found = self._contact.estimate(straight, time_s, any(self._healthy.tolist()))
        estimate = found or straight or Estimate(time_s, tracker.state, reason=self._no_contact())
        if straight is not None:
            used = tracker.usable.tolist().count(True)
            estimate = estimate._replace(misfit=straight.misfit, accelerometers=used)
        return self._complete(estimate, self._contact.track)

    def _complete(self, estimate: Estimate, track: Track | None) -> Estimate:
        """The estimate with what is common to straight slides and tracks."""
        if not self._contact.touches_down:
            chamber, ball = self.card.sensor["chamber_mm"], self.card.sensor.get("indenter_diameter_mm", 0.0)
            estimate = held_at_rim(estimate, chamber, ball)
        if self._forces is not None:
            gain = track.gain if track is not None and estimate.contact is Contact.PRESS else 1.0
            estimate = self._forces.with_force(estimate, min(max(gain, 0.0), 1.0))
        return self._sensor.mark(estimate)

    def _no_contact(self) -> Reason:
        if not any(self._healthy.tolist()):
            return Reason.DEAD_CHANNEL
        return Reason.NO_CONTACT if any(self._tracker.known.tolist()) else Reason.UNKNOWN_ZERO

    def _read_sensor(self, in_use: np.ndarray) -> None:
        if self._sensor.read(self._tracker, in_use, self._healthy):
            self._take_height(self._sensor.height_mm)

    def _take_height(self, height_mm: float) -> None:
        """Reads the map at this height of the skin; NaN: at the height that most of its recordings had."""
        heights = self.card.heights
        if heights is None:
            return
        off_mm = 0.0 if math.isnan(height_mm) else height_mm - heights.height_mm
        self._inputs[HEIGHT_INPUT][0] = off_mm
        # Which height the track is of must not depend on what was read before the stream began anew.
        self._contact.read_at(round(off_mm / MAP_STEP_MM), MAP_STEP_MM)

    def _whole_blocks(
        self, volts: np.ndarray, time_s: np.ndarray | None
    ) -> Iterator[tuple[np.ndarray, tuple[float, float]]]:
        volts, time_s = checked_samples(volts, time_s, len(self.card.columns))
        for piece in self._clock.place(volts, time_s):
            yield from self._blocks.push(piece)

    def _advance(self, samples: np.ndarray, shares: tuple[float, float]) -> None:
        tracker = self._tracker
        sliding, usable = tracker.state is SlideState.SLIDE, tracker.usable
        touched = sliding or tracker.static_output.searching
        block = self._without_base(self._watch.push(samples, shares, touched))
        tracker.push(self.card.conditioning.scale * block.mean, block.healthy)
        self._count += 1
        self._healthy, self._bridging = block.healthy, block.bridged
        self._contact.follow(block.healthy, self._count)
        self._sensor.note(tracker)
        if tracker.state is SlideState.SLIDE:
            if not sliding:
                self._contact.begin()
                self._bridged = self._slide_blocks = 0
                self._gravity.begin()
            self._gravity.push(tracker.static, tracker.subtracted, tracker.usable & self._healthy)
            if not sliding or tracker.usable is not usable:
                # The static output stays as it is while something slides.
                self._read_sensor(tracker.usable)
            self._slide_blocks += 1
            bridged = bool((block.bridged & tracker.usable).any())
            self._bridged += bridged
            self._whole = not bridged and self._bridged <= BRIDGED_SHARE * self._slide_blocks
            fits = self._count % FIT_BLOCKS == 0 and self._contact.wants_fit
            if fits and (window := tracker.window()) is not None:
                straight = self._fitted(window)
                self._contact.take_fit(straight, self._permitted(straight), window.elapsed_s)
        elif tracker.final is None:
            self._held = None
        elif self._held is None or self._held[0] is not tracker.final:
            # Computed as the slide ends, so that the result does not depend on when it is read.
            straight = self._permitted(self._fitted(tracker.final))
            self._held = tracker.final, self._chosen(straight, 0.0)
        if tracker.state is not SlideState.SLIDE and self._count % DRIFT_BLOCKS == 0:
            self._read_sensor(block.healthy)

    def _without_base(self, block: Judged) -> Judged:
        """The block in the attitude of the calibration; the skin's outputs are worth no more than the base's."""
        base, channels = self.card.base, len(self.card.channels)
        if base is None:
            return block
        mean, upright = base.without(block.mean[:channels], block.mean[channels:])
        healthy = block.healthy[:-1] & block.healthy[-1] & upright
        return Judged(mean, healthy, block.bridged[:-1] | block.bridged[-1])


def _frozen_blocks(card: Card) -> float:
    """After how many blocks without a change a channel is frozen, by the noise that the calibration shows."""
    if card.contact is None:
        return FROZEN_BLOCKS
    noise_v = min(card.contact.noise_v) * math.sqrt(card.block_samples) / card.conditioning.scale
    return frozen_blocks(card.sensor.get("adc_step_v", 0.0), noise_v, card.block_samples)


def _lag_blocks(card: Card, lag_s: float) -> int:
    if not 0.0 <= lag_s <= MOST_LAG_S:
        raise InputError(f"{lag_s:g} s is not from 0 to {MOST_LAG_S:g} s", "lag")
    if lag_s and (card.contact is None or card.input == "features"):
        raise InputError(f"a lag of {lag_s:g} s: this bundle follows no contacts, and so has none", "lag")
    return round(lag_s / card.conditioning.block_s)

"""Tracks one contact from touch to release: where it is and how it moves, with a covariance, at each block."""

import copy
import math
from collections import deque
from typing import NamedTuple

import numpy as np

from softslide.features.contact.block_noise import BlockNoise
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.evidence import Evidence
from softslide.features.contact.hypotheses import (
    ACCELERATION,
    CURVATURE,
    DEPTH,
    FRICTION,
    GAIN,
    HEADING,
    MANOEUVRE_MM,
    PARTIAL_SHARE,
    PEAK_SHARE,
    RISE,
    SPEED,
    Hypotheses,
    X,
    Y,
    joined,
    placed,
    predict,
    remember,
    remembering,
    started,
    update,
)
from softslide.features.contact.manoeuvres import branched, merged
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.touch import at_rest, at_touch, onset
from softslide.features.contact.touch_down import at_touch_down
from softslide.features.contact.track import Track, moved_on, read, read_past
from softslide.features.contact.tracking_config import TINY, TrackingConfig
from softslide.features.stream.conditioning import Conditioning, LagUndone

TOUCH_MOST = 100  # hypotheses at a touch
# Logarithms: a hypothesis is dropped beyond these odds to the best; those of rest, where the output first settles, to
# the other hypotheses.
LEAST_ODDS, RESTING_ODDS = 15.0, -2.0
HELD_RISE = 0.05  # 1/s: the gain of a contact that stands still, half pressed on, changes by less
ONSET_BLOCKS = 12
TRIGGER_BLOCKS = 5
# A contact comes down and is lifted within a block, which then shows a part of it; so many whole ones show the place.
PARTIAL_BLOCKS = 1
PLACE_BLOCKS = 2
RELEASE_S = 0.3
LOST_S = 0.5
# An output rests when its slope is within so many standard deviations and so large a share of it a second: a contact
# pressed on at 2 mm/s rises tenfold as fast, the creep after it is below.
SETTLED_SD = 5.0
SETTLED_SHARE = 0.03
# A straight fit is weighed by the last 2 s of measurements, by a tenth of that at least; before them it is as likely as
# not. With 0.8 s it won against true changes of speed (synthetic paths, experiments/LOG.md).
PAST_STEPS = 50
LEAST_PAST_STEPS = 5
STRAIGHT = 0.5


class StraightFit(NamedTuple):
    """A straight slide at constant speed, as it stands now: x, y (mm), heading (rad), speed (mm/s), depth (mm off the
    map's), their standard deviations (the speed's as a share of it), and the way so far (mm)."""

    x_mm: float
    y_mm: float
    heading: float
    speed_mm_s: float
    depth_mm: float
    place_sd_mm: float
    heading_sd: float
    speed_sd: float
    depth_sd_mm: float
    way_mm: float


class _Step(NamedTuple):
    """One measurement (C,) V, its variance (C,) V^2, and the logarithm of its predicted density under the bank."""

    volts: np.ndarray
    variance: np.ndarray
    log_density: float


class ContactTracker:
    """One stream's tracker.

    surface: the calibrated response, at the skin's height; calibration, conditioning: the card's. lag_blocks: how far
    back `past` reads.

    gained: by the last block, the logarithm of the odds of a contact against a signal that needs no map.
    """

    def __init__(
        self,
        surface: ResponseSurface,
        calibration: ContactCalibration,
        conditioning: Conditioning,
        config: TrackingConfig,
        lag_blocks: int = 0,
    ) -> None:
        self._surface, self._calibration = surface, calibration
        self._conditioning, self._config = conditioning, config
        self._block_s, self._step_s = conditioning.block_s, config.step_blocks * conditioning.block_s
        self._remembered = math.ceil(lag_blocks / config.step_blocks) + 1 if lag_blocks else 0
        # Of one block, with the lag undone.
        noise_gain = LagUndone(conditioning, surface.channels).noise_gain
        noise_v = noise_gain * np.array(calibration.noise_v)
        # Of a measurement about what a hypothesis expects, V^2: the noise, or all that the map leaves.
        self._variance = noise_v**2 / config.step_blocks
        # The state of a contact that comes down is that of its block's middle.
        self._ahead_s = 0.0
        if config.comes_down:
            self._variance = np.full(surface.channels, calibration.floor_v**2)
            self._ahead_s = self._block_s / 2
        self._noise = BlockNoise(noise_v, self._block_s)
        self._recent = np.zeros((ONSET_BLOCKS, surface.channels))
        self._evidence = Evidence(
            noise_v / math.sqrt(config.step_blocks),
            self._step_s,
            conditioning.trigger_v,
            # A press of a contact that comes down anywhere is not distinguished from the whole device's motion.
            () if config.comes_down else calibration.inflation_v_per_mm,
            config.least_log_odds,
            config.prior_steps,
        )
        self.reset()

    def reset(self) -> None:
        """Forgets the contact and the last blocks."""
        self.gained = 0.0
        self._noise.reset()
        self._bank: Hypotheses | None = None
        self._track: Track | None = None
        self._before: Track | None = None
        self._touched = self._lifted = self._rested = False
        self._filled = self._steps = self._blocks = self._quiet = self._lost = 0
        self._past: deque[_Step] = deque(maxlen=PAST_STEPS)

    def copied(self) -> "ContactTracker":
        """Another one that has read the same; they share what never changes."""
        shared = (self._surface, self._calibration, self._conditioning, self._config)
        return copy.deepcopy(self, {id(each): each for each in shared})

    def push(self, volts: np.ndarray, touched: bool, usable: np.ndarray) -> Track | None:
        """One block: volts (C,) V of the tilt channels, subtracted, the lag undone; touched: whether the output is off
        the static one, which starts a track; usable: (C,) bool. -> the contact, None if none is tracked; one that comes
        down anywhere, once it is lifted, as it was before."""
        self.gained = 0.0
        if self._config.comes_down and not self._is_down(volts, touched, usable):
            return self._track
        self._recent[:-1] = self._recent[1:]
        # What a dead channel shows is not the contact's.
        self._recent[-1] = np.where(usable, volts, 0.0)
        self._filled = min(self._filled + 1, ONSET_BLOCKS)
        # All that the map of a contact that comes down leaves is in its variance.
        if self._filled > 2 and not self._config.comes_down:
            self._noise.push(self._recent[-3:])
        if self._bank is None:
            if self._begins(touched):
                self._start(usable)
            return self._track
        self._blocks += 1
        if self._blocks % self._config.step_blocks == 0:
            self._step(usable)
        else:
            self._track = None if self._track is None else moved_on(self._track, self._block_s)
            # Between two measurements, so that no block takes much longer than the others.
            self._branch()
        return self._track

    def _is_down(self, volts: np.ndarray, touched: bool, usable: np.ndarray) -> bool:
        """Whether a contact that comes down and is lifted within a block is there."""
        if not touched and not self._touched:
            self.reset()
        self._touched = touched
        if not touched or self._lifted:
            return False
        if np.abs(volts[usable]).max(initial=0.0) < self._conditioning.release_v:
            # The block before this one may have shown a part of a contact that was being lifted.
            self._lifted, self._track = True, self._before
            return False
        self._before = self._track
        return True

    def _begins(self, touched: bool) -> bool:
        """Whether the last blocks show enough of a contact for a track to start."""
        if self._config.comes_down:
            return self._filled >= PARTIAL_BLOCKS + PLACE_BLOCKS
        # A slide's end is noticed later than the output is gone: no new track begins in what is left of it.
        level = self._recent[-TRIGGER_BLOCKS:].mean(axis=0)
        return (
            touched
            and self._filled >= TRIGGER_BLOCKS
            and float(np.abs(level).max()) > self._conditioning.trigger_v
        )

    def _start(self, usable: np.ndarray, anew: bool = False) -> None:
        """anew: the contact goes on, but its track was lost."""
        config, recent = self._config, self._recent[-self._filled :]
        if config.local is not None:
            recent = recent[-PLACE_BLOCKS:]
            level = recent.mean(axis=0)
            slope = (recent[-1] - recent[0]) / ((PLACE_BLOCKS - 1) * self._block_s)
            variance = np.where(usable, self._variance, np.inf)
            bank: Hypotheses | None = at_touch_down(
                level, variance, self._surface, self._calibration, config.local
            )
        else:
            seen = onset(recent, self._block_s, np.where(usable, self._noise.now_v, np.inf))
            level, slope = seen.level, seen.slope
            bank = at_touch(seen, self._surface, self._calibration, TOUCH_MOST, anywhere=anew)
        self._bank = None if bank is None else remembering(bank, self._remembered)
        self._evidence.begin(usable, level, slope, anew)
        self._blocks = self._steps = self._quiet = self._lost = 0
        self._rested = False
        self._past.clear()
        # Places with a fan of headings each are no motion yet.
        self._track = None
        if self._bank is not None and not config.comes_down:
            self._track = read(self._bank, self._residual_v(level)[0])

    def _step(self, usable: np.ndarray) -> None:
        assert self._bank is not None
        config, elapsed_s = self._config, self._step_s
        volts = self._measured()
        self._quiet = self._quiet + 1 if float(np.abs(volts).max()) < self._conditioning.release_v else 0
        if self._quiet * elapsed_s > RELEASE_S:
            self._bank = self._track = None
            return
        if not usable.any():
            self._bank = remembering(self._bank, self._remembered)
            return
        vibration = self._noise.vibration_v2 / config.step_blocks
        variance = np.where(usable, self._variance + vibration, np.inf)
        predict(self._bank, elapsed_s, *self._residual_v(volts), config.noise)
        log_density, misfit = update(self._bank, volts, variance, self._surface, elapsed_s, config.local)
        remember(self._bank)
        self._past.append(_Step(volts, variance, log_density))
        sound = self._bank.sound
        if not sound.all():
            # A signal that no contact makes can drive a covariance out of the positive definite.
            if not sound.any():
                self._start(usable, anew=True)
                return
            self._bank, log_density = self._bank.take(sound), math.nan
        way_mm = elapsed_s * self._bank.best_speed
        self.gained = self._evidence.add(volts, usable, log_density, misfit, way_mm, vibration)
        self._doubt()
        self._steps += 1
        if self._steps <= config.first_steps:
            self._bank = self._bank.likeliest(TOUCH_MOST)
        if usable.all() and not self._rested and self._steps * elapsed_s < config.young_s:
            self._rest()
        if config.step_blocks == 1:
            self._branch()
        self._track = self._read_track(volts)
        self._lost = self._lost + 1 if self._track.misfit > config.lost else 0
        if self._lost * elapsed_s > LOST_S:
            self._start(usable, anew=True)

    def past(self, blocks: int) -> Track | None:
        """The contact so many blocks ago, by what was measured since; None where it was not tracked then."""
        if self._bank is None or self._track is None:
            return None
        if self._config.comes_down and (self._lifted or not self._touched):
            return None
        each = self._config.step_blocks
        since = self._blocks % each
        steps = math.ceil((blocks - since) / each)
        track = read_past(self._bank, steps, self._residual_v(self._measured())[0])
        if track is None:
            return None
        track = moved_on(track, (steps * each + since - blocks) * self._block_s + self._ahead_s)
        return track._replace(evidence=self._track.evidence)

    def offer(self, fit: StraightFit) -> None:
        """Takes a fit into the bank, with the weight that the last measurements give it.

        Its filter goes through them from where the line was then, so that its likelihood is of the same measurements as
        the bank's.
        """
        if self._bank is None or len(self._past) < LEAST_PAST_STEPS:
            return
        since_s = self._blocks % self._config.step_blocks * self._block_s
        line = self._on_line(fit, len(self._past) * self._step_s + since_s)
        odds = math.log(STRAIGHT)
        for volts, variance, log_density in self._past:
            predict(line, self._step_s, *self._residual_v(volts), self._config.noise)
            odds += update(line, volts, variance, self._surface, self._step_s)[0] - log_density
            remember(line)
        if not line.sound.all() or not math.isfinite(odds):
            return
        line.age_mm[:] = min(fit.way_mm, MANOEUVRE_MM)
        line.log_weight += np.logaddexp.reduce(self._bank.log_weight) + odds
        self._bank = joined([self._bank, line])
        self._bank.log_weight -= self._bank.log_weight.max()
        self._track = moved_on(self._read_track(self._measured()), since_s)

    def _measured(self) -> np.ndarray:
        """(C,) V: the mean of the last step's blocks."""
        return self._recent[-self._config.step_blocks :].mean(axis=0)

    def _residual_v(self, volts: np.ndarray) -> tuple[float, float]:
        """What is correlated over the way of what the map leaves of an output (C,) V, and what that grows by in 1 s
        while a contact is pressed on or lifted, V."""
        if self._config.comes_down:
            return TINY, 0.0
        floor_v, share = self._calibration.floor_v, self._calibration.floor_share
        peak_v = float(np.abs(volts).max())
        partial_v = PARTIAL_SHARE * peak_v
        if share is None:
            return floor_v + PEAK_SHARE * peak_v, partial_v
        return math.hypot(floor_v, share * peak_v, PEAK_SHARE * peak_v), partial_v

    def _on_line(self, fit: StraightFit, ago_s: float) -> Hypotheses:
        """The hypothesis that a straight fit was so long ago."""
        cos, sin, way_mm = math.cos(fit.heading), math.sin(fit.heading), fit.speed_mm_s * ago_s
        x_mm, y_mm = np.array([fit.x_mm - way_mm * cos]), np.array([fit.y_mm - way_mm * sin])
        state = placed(x_mm, y_mm, self._surface.channels)
        state[:, HEADING], state[:, SPEED], state[:, DEPTH] = fit.heading, fit.speed_mm_s, fit.depth_mm
        state[:, FRICTION] = cos, sin
        sd = np.full(state.shape, self._calibration.floor_v)
        sd[:, X] = sd[:, Y] = fit.place_sd_mm + fit.speed_sd * way_mm
        sd[:, HEADING], sd[:, SPEED] = fit.heading_sd, fit.speed_sd * fit.speed_mm_s
        sd[:, ACCELERATION], sd[:, CURVATURE], sd[:, GAIN] = 0.0, 0.001, self._calibration.gain_sd
        sd[:, DEPTH], sd[:, RISE], sd[:, FRICTION] = fit.depth_sd_mm, 0.0, 0.02
        return remembering(started(state, sd, np.zeros(1), partial=False), self._remembered)

    def _read_track(self, volts: np.ndarray) -> Track:
        """The contact now. volts: (C,) V, the last measurement."""
        assert self._bank is not None
        now = self._bank
        if self._ahead_s:
            now = now.take(slice(None))
            predict(now, self._ahead_s, TINY, 0.0, self._config.noise)
        return read(now, self._residual_v(volts)[0])._replace(evidence=self._evidence.read(volts))

    def _branch(self) -> None:
        """Every few steps drops what is unlikely and gives the best hypotheses their children."""
        assert self._bank is not None
        config = self._config
        if self._steps == 0 or self._steps % config.branch_steps:
            return
        self._bank = merged(self._bank, config.most, config.most_partial, LEAST_ODDS)
        if self._steps > config.first_steps:
            self._bank = branched(
                self._bank, config.parents, config.parent_odds, self._calibration.gain_sd, config.manoeuvres
            )

    def _rest(self) -> None:
        """When the output first settles after the touch: the contact may have been pressed on where it rests."""
        assert self._bank is not None
        seen = onset(self._recent[-self._filled :], self._block_s, self._noise.now_v)
        still = SETTLED_SD * seen.slope_sd + SETTLED_SHARE * np.abs(seen.level).max()
        if self._filled < ONSET_BLOCKS or (np.abs(seen.slope) > still).any():
            return
        self._rested = True
        resting = at_rest(seen, self._surface, self._calibration, self._residual_v(seen.level)[0])
        if resting is not None:
            resting.log_weight += RESTING_ODDS - np.logaddexp.reduce(resting.log_weight)
            likeliest = remembering(resting.likeliest(TOUCH_MOST), self._remembered)
            self._bank = joined([self._bank, likeliest])

    def _doubt(self) -> None:
        """A place far off the chamber, a gain beyond reason, or a press that stands still is unlikely."""
        assert self._bank is not None
        config, gain = self._config, self._bank.state[:, GAIN]
        beyond_mm = np.maximum(self._bank.beyond_mm(self._calibration.chamber_half_mm) - config.edge_mm, 0.0)
        unlikely = config.edge_cost * beyond_mm**config.edge_power
        unlikely += 10.0 * np.maximum(gain - config.most_gain, 0.0) ** 2 + 0.5 * (gain < 0.0)
        # What is pressed on or lifted is on its way to a whole contact, or off the skin.
        held = np.exp(-0.5 * (self._bank.state[:, RISE] / HELD_RISE) ** 2)
        unlikely += self._bank.partial * config.held_cost * self._step_s * held
        self._bank.log_weight -= unlikely
        self._bank.log_weight -= self._bank.log_weight.max()

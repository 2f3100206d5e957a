"""Tracks contacts that are there from one block to the next, anywhere on the skin, and are lifted as fast.

Nothing is known of such a skin but its recordings. What its map leaves is white from block to block and grows with the
response's slope and size: an error of place and one of gain that all channels share, and a part that is alike
everywhere. The first blocks show the place; each place gets a fan of headings and speeds, and the next steps decide
between them.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from softslide.features.contact.evidence import Evidence
from softslide.features.contact.hypotheses import (
    ACCELERATION,
    CURVATURE,
    FRICTION,
    GAIN,
    HEADING,
    MISFIT_S,
    RESIDUAL,
    SPEED,
    Hypotheses,
    LocalErrors,
    MotionNoise,
    X,
    Y,
    predict,
    remember,
    remembering,
    started,
    update,
)
from softslide.features.contact.manoeuvres import Manoeuvres, branched, merged
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.track import Track, moved_on, read, read_past

# A contact comes down and is lifted within a block, which then shows a part of it.
PARTIAL_BLOCKS = 1
START_BLOCKS = 2  # whole ones that the first place is read from
GRID_MM = 1.25
PLACES = 16  # at most, and not less likely than the best by more than PLACE_ODDS
PLACE_ODDS = 8.0  # logarithm
HEADINGS = 8
SPEEDS_MM_S = (8.0, 20.0, 45.0)
SPEED_SHARE = 0.4  # standard deviation of each of these
START_CURVATURE = 0.12  # 1/mm, standard deviation
FIRST_STEPS = 12  # before there are branches
BRANCH_STEPS = 3
BEYOND_MM = 0.5  # of the chamber's edge; the map ends there
TINY = 1e-9  # of what such a map does not know: friction, other depths, residuals along the way
NEVER = 1e-9
# Least logarithm of the odds of a contact that a block adds: while the residual of such a map stays as it is, from one
# press to the next, a smooth signal predicts the output better (experiments/LOG.md).
LEAST_LOG_ODDS = -2.0
# As many blocks count as what the calibration says of the residual's size: slides on smooth skins leave less than that
# (a formula's map: 5 and 10 mm/s reach -74 and -37 of log odds; with one block -95 and -65).
PRIOR_BLOCKS = 0.1

# Contacts bend and change speed, and no more: where presses stand for a motion, one that is held looks like a stop, and
# hypotheses that stop, turn back or turn a corner follow these instead of the motion (experiments/LOG.md).
SLIDING_ON = MotionNoise(
    place=0.01, heading=0.01, speed=0.03, acceleration=TINY, curvature=0.01, gain=0.002, depth=TINY
)
BENDS = Manoeuvres(
    steering=(0.2, 0.6, 0.2),
    speed=0.3,
    acceleration=TINY,
    curvature=0.3,
    stop=NEVER,
    back=NEVER,
    corner=NEVER,
    restart=NEVER,
    lift=NEVER,
    lift_at_rest=NEVER,
)


@dataclass(frozen=True)
class TouchDownConfig:
    """local, level_share: what the map leaves of a block: errors of place and gain, and what is alike everywhere, as a
    share of the variance in calibration. first, most: hypotheses kept after a touch and after a branching; parents:
    that get children, within parent_odds. log_odds: of a hypothesis to the best, beyond which it is dropped. Chosen on
    circles, S-curves and lines assembled from a pass and places that the map had not seen (experiments/LOG.md).
    remembered: as in `TrackingConfig`."""

    noise: MotionNoise = field(default_factory=lambda: SLIDING_ON)
    manoeuvres: Manoeuvres = field(default_factory=lambda: BENDS)
    local: LocalErrors = field(default_factory=lambda: LocalErrors(0.42, 0.07))
    level_share: float = 1.0
    first: int = 100
    most: int = 24
    parents: int = 4
    parent_odds: float = 6.0
    log_odds: float = 15.0
    remembered: int = 0


class TouchDownTracker:
    """One stream's tracker; it is pushed and read as `ContactTracker` is.

    surface: the calibrated response. half_mm: half the chamber's sizes. noise_v: (C,) V of one block. floor_v: V, the
    map's residual. gain_sd: from slide to slide. trigger_v, release_v: V, outputs that begin and end a contact.
    """

    def __init__(
        self,
        surface: ResponseSurface,
        half_mm: tuple[float, float],
        block_s: float,
        noise_v: np.ndarray,
        floor_v: float,
        gain_sd: float,
        trigger_v: float,
        release_v: float,
        config: TouchDownConfig,
    ) -> None:
        self._surface, self._half, self._block_s, self._config = surface, half_mm, block_s, config
        self._variance = np.full(surface.channels, config.level_share * floor_v**2)
        self._gain_sd, self._release_v = gain_sd, release_v
        self._evidence = Evidence(noise_v, block_s, trigger_v, least=LEAST_LOG_ODDS)
        self.reset()

    def reset(self) -> None:
        """Forgets the contact and the last blocks."""
        self._bank: Hypotheses | None = None
        self._track: Track | None = None
        self._before: Track | None = None
        self._blocks: list[np.ndarray] = []  # of the touch
        self._touched = self._lifted = False
        self._steps = 0
        # Of the contact so far: the sum of the likeliest hypotheses' chi-square over C, from step to step.
        self._misfits = PRIOR_BLOCKS

    @property
    def tracking(self) -> bool:
        """Whether a contact is tracked."""
        return self._bank is not None

    def push(self, volts: np.ndarray, touched: bool, usable: np.ndarray) -> Track | None:
        """One block: volts (C,) V, subtracted; touched: whether the output is off the static one; usable: (C,) bool.
        -> the contact, once it is lifted as it was before; None if none is tracked."""
        if not touched:
            if not self._touched:
                self.reset()
            self._touched = False
            return self._track
        self._touched = True
        if self._lifted:
            return self._track
        if np.abs(volts[usable]).max(initial=0.0) < self._release_v:
            # The block before this one may have shown a part of a contact that was being lifted.
            self._lifted, self._track = True, self._before
            return self._track
        self._before = self._track
        if self._bank is not None:
            self._step(volts, usable)
            return self._track
        self._blocks.append(volts)
        if len(self._blocks) == PARTIAL_BLOCKS + START_BLOCKS:
            self._start(usable)
        return self._track

    def past(self, blocks: int) -> Track | None:
        """As `ContactTracker.past`."""
        if self._bank is None or self._lifted or not self._touched:
            return None
        track = read_past(self._bank, blocks)
        if track is None or self._track is None:
            return None
        return moved_on(track, self._block_s / 2)._replace(evidence=self._track.evidence)

    def _by_scale(self, before: np.ndarray, channels: int) -> float:
        """What a block's log density gains where the residual's variance is that of the contact so far, and not the
        calibration's alone. before: (N,) misfits before the block."""
        assert self._bank is not None
        best = int(self._bank.log_weight.argmax())
        share = min(self._block_s / MISFIT_S, 1.0)
        misfit = float(before[best] + (self._bank.misfit[best] - before[best]) / share)
        scale = min(self._misfits / (PRIOR_BLOCKS + self._steps), 1.0)
        self._misfits += misfit
        return 0.5 * channels * (misfit * (1.0 - 1.0 / scale) - math.log(scale))

    def _start(self, usable: np.ndarray) -> None:
        whole = self._blocks[PARTIAL_BLOCKS:]
        volts, variance = np.mean(whole, axis=0), np.where(usable, self._variance, np.inf)
        slope_v_s = (whole[-1] - whole[0]) / ((START_BLOCKS - 1) * self._block_s)
        self._evidence.begin(usable, volts, slope_v_s)
        bank = at_touch_down(volts, variance, self._surface, self._half, self._gain_sd, self._config)
        self._bank = remembering(bank, self._config.remembered)

    def _step(self, volts: np.ndarray, usable: np.ndarray) -> None:
        assert self._bank is not None
        config, variance = self._config, np.where(usable, self._variance, np.inf)
        predict(self._bank, self._block_s, TINY, 0.0, config.noise)
        before = self._bank.misfit.copy()
        gained = update(self._bank, volts, variance, self._surface, self._block_s, config.local)
        gained += self._by_scale(before, int(usable.sum())) - self._evidence.against(volts, usable)
        self._evidence.add(gained, self._block_s * self._bank.best_speed)
        remember(self._bank)
        bank = self._bank
        outside_mm = np.maximum(bank.beyond_mm(self._half) - BEYOND_MM, 0.0)
        bank.log_weight -= 0.5 * (outside_mm / BEYOND_MM) ** 2
        sound = bank.sound
        if not sound.any():
            self.reset()
            return
        bank = bank.take(sound)
        bank.log_weight -= bank.log_weight.max()
        self._steps += 1
        if self._steps <= FIRST_STEPS:
            bank = bank.likeliest(config.first)
        if self._steps % BRANCH_STEPS == 0:
            bank = merged(bank, config.most, 1, config.log_odds)
            if self._steps > FIRST_STEPS:
                bank = branched(bank, config.parents, config.parent_odds, self._gain_sd, config.manoeuvres)
        self._bank = bank
        # The state is that of the block's middle.
        now = bank.take(slice(None))
        predict(now, self._block_s / 2, TINY, 0.0, config.noise)
        self._track = read(now)._replace(evidence=self._evidence.read(volts))


def at_touch_down(
    volts: np.ndarray,
    variance: np.ndarray,
    surface: ResponseSurface,
    half_mm: tuple[float, float],
    gain_sd: float,
    config: TouchDownConfig,
) -> Hypotheses:
    """The likeliest places, each with a fan of headings and speeds.

    volts: (C,) V, what the touch shows; variance: (C,) V^2 of a step's residual, infinite for a dead channel.
    """
    axes = [np.arange(-h, h + GRID_MM / 2, GRID_MM) for h in half_mm]
    x, y = (axis.ravel() for axis in np.meshgrid(*axes, indexing="ij"))
    use = np.isfinite(variance)
    response = surface.at(x, y)[:, :, 0][..., use]
    shown, slopes = response[:, 0], response[:, 1:]
    place = config.local.place_mm**2 + (GRID_MM / 2) ** 2
    spread = np.diag(variance[use]) + place * (slopes.transpose(0, 2, 1) @ slopes)
    spread = spread + gain_sd**2 * shown[:, :, None] * shown[:, None]
    gap = volts[use] - shown
    off = 0.5 * (
        (gap * np.linalg.solve(spread, gap[..., None])[..., 0]).sum(1) + np.linalg.slogdet(spread)[1]
    )
    places = np.argsort(off, kind="stable")[:PLACES]
    places = places[off[places] < off[places[0]] + PLACE_ODDS]
    at, turn, speed = (
        axis.ravel() for axis in np.meshgrid(places, np.arange(HEADINGS), SPEEDS_MM_S, indexing="ij")
    )
    heading = turn * 2 * np.pi / HEADINGS
    state = np.zeros((len(at), RESIDUAL + surface.channels))
    state[:, X], state[:, Y], state[:, HEADING], state[:, SPEED] = x[at], y[at], heading, speed
    state[:, GAIN] = 1.0
    state[:, FRICTION] = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    sd = np.full(state.shape, TINY)
    sd[:, X] = sd[:, Y] = GRID_MM / 2
    sd[:, HEADING], sd[:, SPEED] = math.pi / HEADINGS, SPEED_SHARE * speed
    sd[:, ACCELERATION], sd[:, CURVATURE], sd[:, GAIN] = 0.01, START_CURVATURE, gain_sd
    return started(state, sd, off[places[0]] - off[at], partial=False)

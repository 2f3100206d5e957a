"""The evidence for a contact: odds of the response map against signals that need no map, and what shows a press."""

import math
from collections.abc import Sequence

import numpy as np

from softslide.features.contact.smooth_signal import SmoothSignal
from softslide.features.contact.track import ContactEvidence

# Memory of the evidence for a contact: of way, and of time, so that a signal that comes to rest earns nothing by it
# (synthetic paths and tilts, experiments/LOG.md).
EVIDENCE_MM = 15.0
EVIDENCE_S = 20.0
# And of the evidence against one: how a contact was pressed on says little of what follows.
EVIDENCE_AGAINST_S = 4.0
# A press rests sooner than this: an output that changes for longer along one direction is a slide's or a drift's, and
# a slide's from this evidence on (synthetic slides and drifts).
PRESS_S = 2.0
SLIDE_LOG_ODDS = 3.0
# A press that is distinguished from all that the whole device does: so large a share of the output is beyond that, the
# output is so many times the trigger, and it never changed for longer than this (experiments/LOG.md).
TOUCH_SHARE = 0.3
PRESS_TRIGGERS = 4.0
PRESS_ON_S = 4.0


def beyond_device(inflation_v_per_mm: np.ndarray) -> np.ndarray:
    """The projection (C, C) of outputs (C,) V, V_x and V_y of each accelerometer, on what only a touch makes.

    The whole device makes two more: a tilt shows alike in all accelerometers, a change of the chamber's pressure along
    inflation_v_per_mm (C,), by which outputs at rest change as the skin rises; only its direction matters. With one
    accelerometer nothing is beyond these; with two a direction is left, and each further one leaves two more.
    """
    channels = len(inflation_v_per_mm)
    tilts = np.tile(np.eye(2), (channels // 2, 1))
    made = np.column_stack([tilts, inflation_v_per_mm])
    # A pressure that tilts all boards alike, or none, adds no direction of its own.
    directions, sizes, _ = np.linalg.svd(made / np.linalg.norm(made, axis=0).clip(1e-12), full_matrices=False)
    kept = directions[:, sizes > 1e-6]
    return np.eye(channels) - kept @ kept.T


class Evidence:
    """Of one contact, step by step.

    noise_v: (C,) V of a step's measurement; step_s: its length. trigger_v: V. inflation_v_per_mm: as in
    ContactCalibration; without it no press is detected. least, prior_steps: `least_log_odds` and `prior_steps` of
    TrackingConfig.
    """

    def __init__(
        self,
        noise_v: np.ndarray,
        step_s: float,
        trigger_v: float,
        inflation_v_per_mm: Sequence[float] = (),
        least: float = -math.inf,
        prior_steps: float | None = None,
    ) -> None:
        self._noise_v, self._step_s, self._trigger_v = noise_v, step_s, trigger_v
        self._least, self._prior_steps = least, prior_steps
        self._beyond_device = beyond_device(np.array(inflation_v_per_mm)) if inflation_v_per_mm else None
        self._use = np.ones(len(noise_v), dtype=bool)
        self._smooth = SmoothSignal(noise_v, step_s)
        self.begin(self._use, np.zeros_like(noise_v), np.zeros_like(noise_v))

    def begin(self, use: np.ndarray, level_v: np.ndarray, slope_v_s: np.ndarray, anew: bool = False) -> None:
        """A contact begins, read from the channels `use` (C,) bool, at a level (C,) and a slope (C,).

        anew: the contact goes on, but its track was lost.
        """
        if not anew:
            self._peak_v = 0.0
        self._log_odds = 0.0
        # How many steps the contact has, and the sum of their misfits.
        self._steps = self._misfits = self._prior_steps or 0.0
        self._watch(use, level_v, slope_v_s)

    def add(
        self,
        volts: np.ndarray,
        use: np.ndarray,
        log_density: float,
        misfit: float,
        way_mm: float,
        vibration_v2: np.ndarray,
    ) -> float:
        """Takes a measurement (C,) V of the channels `use` (C,) bool, and forgets some of what was gained before.

        log_density: the logarithm of its density under the map, less C/2 log(2 pi), NaN where that is not known;
        misfit: its chi-square over C; way_mm: of the step; vibration_v2: (C,) V^2, what the variance of its noise is
        larger by than at rest. -> the logarithm of the step's odds.
        """
        self._peak_v = max(self._peak_v, float(np.abs(volts[use]).max()))
        if not np.array_equal(use, self._use):
            # An accelerometer has failed: the alternatives, too, are of the channels that are left.
            self._watch(use, volts, np.zeros_like(volts))
        gained = log_density - self._smooth.push(volts[use], vibration_v2[use])
        if self._prior_steps is not None:
            gained += self._by_scale(misfit)
        if math.isnan(gained):
            gained = 0.0
        fades = self._step_s / EVIDENCE_S + way_mm / EVIDENCE_MM
        if self._log_odds < 0.0:
            fades = self._step_s / EVIDENCE_AGAINST_S
        self._log_odds += max(gained, self._least) - self._log_odds * min(fades, 1.0)
        return gained

    def read(self, volts: np.ndarray) -> ContactEvidence:
        """What it is now that the output is (C,) V."""
        one_press = self._smooth.one_way and (
            self._smooth.changing_s < PRESS_S or self._log_odds < SLIDE_LOG_ODDS
        )
        return ContactEvidence(
            log_odds=self._log_odds,
            channels=int(self._use.sum()),
            triggers=self._peak_v / self._trigger_v,
            one_press=one_press,
            presses=one_press and bool(self._use.all()) and self._presses(volts),
        )

    def _by_scale(self, misfit: float) -> float:
        """What a step's log density gains where the residual's variance is that of the contact so far, at most that of
        the calibration."""
        scale = min(self._misfits / self._steps, 1.0)
        self._misfits += misfit
        self._steps += 1.0
        return 0.5 * int(self._use.sum()) * (misfit * (1.0 - 1.0 / scale) - math.log(scale))

    def _watch(self, use: np.ndarray, level_v: np.ndarray, slope_v_s: np.ndarray) -> None:
        """Starts the alternatives to a contact on these channels."""
        if not np.array_equal(use, self._use):
            self._use = use.copy()
            self._smooth = SmoothSignal(self._noise_v[use], self._step_s)
        self._smooth.reset(level_v[use], slope_v_s[use])

    def _presses(self, volts: np.ndarray) -> bool:
        """Whether an output (C,) V that has kept one direction is a press's, and not a tilt's or the pressure's."""
        changes = self._smooth.changing_s >= PRESS_S or self._smooth.changed_s > PRESS_ON_S
        if self._beyond_device is None or changes:
            return False
        size = float(np.hypot.reduce(volts))
        beyond = float(np.hypot.reduce(self._beyond_device @ volts))
        return size > PRESS_TRIGGERS * self._trigger_v and beyond > TOUCH_SHARE * size

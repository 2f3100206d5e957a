"""A Kalman filter over a slide's estimates: place and velocity that do not jump, gone on from where none is believed.

The network reads each window afresh, so that neighbouring estimates differ by its error at either moment. The contact
itself moves steadily: state (x, y, v_x, v_y), constant velocity but for a white acceleration, measured by every valid
estimate with the variances that its intervals stand for. Neighbouring estimates share nearly all of their samples;
each counts as the share of an independent one that is new.
"""

import math

import numpy as np

from features.angles import wrapped_deg
from features.estimate import Estimate
from features.stream.tracker import SlideState

HALF_WIDTH_SD = 1.645  # of a 90 % interval, in standard deviations
ACCELERATION_MM_S2 = 2.0
NEW_SHARE = 0.3  # of an estimate's evidence that the one before did not hold
LEAST_SD_MM = 0.05
GATE = 30.0  # squared Mahalanobis distance (4 degrees of freedom) beyond which an estimate is another slide's
PATIENCE = 10  # estimates in a row beyond the gate after which they are believed


class TrackFilter:
    """One stream's filter. Estimates in order of time, one for each block."""

    def __init__(self, acceleration_mm_s2: float = ACCELERATION_MM_S2) -> None:
        self._acceleration = acceleration_mm_s2
        self.reset()

    def reset(self) -> None:
        """Forgets the slide."""
        self._state: np.ndarray | None = None
        self._covariance = np.zeros((4, 4))
        self._time_s = math.nan
        self._refused = 0

    def update(self, estimate: Estimate) -> Estimate:
        """The estimate with place, direction and speed filtered; its intervals move along and keep their widths.

        Anything that is not a valid estimate of a running slide passes as it is: before the first valid one there is
        nothing to go on from, and the end of a slide ends the track.
        """
        if estimate.state is not SlideState.SLIDE:
            self.reset()
            return estimate
        if self._state is not None:
            self._predict(estimate.time_s - self._time_s)
        self._time_s = estimate.time_s
        if not estimate.valid or not math.isfinite(estimate.x_mm):
            return estimate
        self._measure(*_measurement(estimate))
        assert self._state is not None
        return _moved(estimate, self._state)

    def _predict(self, elapsed_s: float) -> None:
        assert self._state is not None
        step = np.eye(4)
        step[0, 2] = step[1, 3] = elapsed_s
        push = np.array([elapsed_s**2 / 2, elapsed_s])
        noise = self._acceleration**2 * np.kron(np.outer(push, push), np.eye(2))
        self._state = step @ self._state
        self._covariance = step @ self._covariance @ step.T + noise

    def _measure(self, value: np.ndarray, covariance: np.ndarray) -> None:
        if self._state is None:
            self._state, self._covariance = value, covariance
            return
        gap = value - self._state
        total = self._covariance + covariance / NEW_SHARE
        far = gap @ np.linalg.solve(self._covariance + covariance, gap) > GATE
        self._refused = self._refused + 1 if far else 0
        if self._refused == PATIENCE:
            self._state, self._covariance, self._refused = value, covariance, 0
        elif not far:
            gain = np.linalg.solve(total, self._covariance).T
            self._state = self._state + gain @ gap
            self._covariance = self._covariance - gain @ self._covariance


def _measurement(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Place mm and velocity mm/s (4,), and their covariance (4, 4), from an estimate's numbers and intervals."""
    angle, speed = math.radians(estimate.direction_deg), estimate.speed_mm_s
    on = np.array([math.cos(angle), math.sin(angle)])
    left = np.array([-on[1], on[0]])
    place_sd = max((estimate.offset_hi_mm - estimate.offset_lo_mm) / 2 / HALF_WIDTH_SD, LEAST_SD_MM)
    turn_sd = math.radians(estimate.direction_hi_deg - estimate.direction_lo_deg) / 2 / HALF_WIDTH_SD
    speed_sd = (estimate.speed_hi_mm_s - estimate.speed_lo_mm_s) / 2 / HALF_WIDTH_SD
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = place_sd**2 * np.eye(2)
    covariance[2:, 2:] = speed_sd**2 * np.outer(on, on) + (speed * turn_sd) ** 2 * np.outer(left, left)
    return np.concatenate([[estimate.x_mm, estimate.y_mm], speed * on]), covariance


def _moved(estimate: Estimate, state: np.ndarray) -> Estimate:
    """The estimate with the filter's place and velocity."""
    speed = math.hypot(state[2], state[3])
    degrees = math.degrees(math.atan2(state[3], state[2])) % 360.0
    turned = wrapped_deg(degrees - estimate.direction_deg)
    faster = speed / estimate.speed_mm_s
    return estimate._replace(
        direction_deg=0.0 if degrees == 360.0 else degrees,
        direction_lo_deg=estimate.direction_lo_deg + turned,
        direction_hi_deg=estimate.direction_hi_deg + turned,
        speed_mm_s=speed,
        speed_lo_mm_s=estimate.speed_lo_mm_s * faster,
        speed_hi_mm_s=estimate.speed_hi_mm_s * faster,
        x_mm=float(state[0]),
        y_mm=float(state[1]),
    )

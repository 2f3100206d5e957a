"""A Kalman filter over the estimates of a slide: position and velocity without jumps.

The model reads each window on its own, so that neighbouring estimates differ by its errors. The filter's state is
(x, y, v_x, v_y) with constant velocity but for a white acceleration; each valid estimate measures all four, with the
variances that its intervals imply. Neighbouring estimates share nearly all of their samples, so each is given the
weight of the share that is new. Figures: experiments/LOG.md.
"""

import math

import numpy as np

from softslide.features.angles import wrapped_deg
from softslide.features.card import HALF_WIDTH_SD
from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState

# Standard deviation of the acceleration, and the share of an estimate's information that the one before did not hold.
# With these the filter takes four fifths of the jitter; a smaller acceleration lags (experiments/LOG.md).
ACCELERATION_MM_S2 = 2.0
NEW_SHARE = 0.3
# A position is never taken to be better than this, about the mean offset error on held-out lines (experiments/LOG.md).
LEAST_SD_MM = 0.05
# Squared Mahalanobis distance beyond which a measurement is an outlier: with four degrees of freedom by chance in 5 of
# a million.
GATE = 30.0
# Outliers in a row, 0.2 s, after which they are believed and the filter begins anew with them.
PATIENCE = 10


class TrackFilter:
    """One stream's filter; it takes estimates in order of time, one a block."""

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
        """The estimate with position, direction and speed filtered; intervals are shifted with them.

        Only valid estimates of a running slide are filtered; all others pass unchanged. The end of a slide resets the
        filter.
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
        from_acceleration = np.array([elapsed_s**2 / 2, elapsed_s])
        noise = self._acceleration**2 * np.kron(np.outer(from_acceleration, from_acceleration), np.eye(2))
        self._state = step @ self._state
        self._covariance = step @ self._covariance @ step.T + noise

    def _measure(self, value: np.ndarray, covariance: np.ndarray) -> None:
        if self._state is None:
            self._state, self._covariance = value, covariance
            return
        innovation = value - self._state
        total = self._covariance + covariance / NEW_SHARE
        far = innovation @ np.linalg.solve(self._covariance + covariance, innovation) > GATE
        self._refused = self._refused + 1 if far else 0
        if self._refused == PATIENCE:
            self._state, self._covariance, self._refused = value, covariance, 0
        elif not far:
            gain = np.linalg.solve(total, self._covariance).T
            self._state = self._state + gain @ innovation
            self._covariance = self._covariance - gain @ self._covariance


def _measurement(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Position mm and velocity mm/s (4,), and their covariance (4, 4), from an estimate and its intervals."""
    angle, speed = math.radians(estimate.direction_deg), estimate.speed_mm_s
    along = np.array([math.cos(angle), math.sin(angle)])
    left = np.array([-along[1], along[0]])
    position_sd = max((estimate.offset_hi_mm - estimate.offset_lo_mm) / 2 / HALF_WIDTH_SD, LEAST_SD_MM)
    direction_sd = math.radians(estimate.direction_hi_deg - estimate.direction_lo_deg) / 2 / HALF_WIDTH_SD
    speed_sd = (estimate.speed_hi_mm_s - estimate.speed_lo_mm_s) / 2 / HALF_WIDTH_SD
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = position_sd**2 * np.eye(2)
    covariance[2:, 2:] = speed_sd**2 * np.outer(along, along) + (speed * direction_sd) ** 2 * np.outer(
        left, left
    )
    return np.concatenate([[estimate.x_mm, estimate.y_mm], speed * along]), covariance


def _moved(estimate: Estimate, state: np.ndarray) -> Estimate:
    """The estimate with the filter's position and velocity (4,)."""
    speed = math.hypot(state[2], state[3])
    degrees = math.degrees(math.atan2(state[3], state[2])) % 360.0
    rotated = wrapped_deg(degrees - estimate.direction_deg)
    speed_ratio = speed / estimate.speed_mm_s
    return estimate._replace(
        direction_deg=0.0 if degrees == 360.0 else degrees,
        direction_lo_deg=estimate.direction_lo_deg + rotated,
        direction_hi_deg=estimate.direction_hi_deg + rotated,
        speed_mm_s=speed,
        speed_lo_mm_s=estimate.speed_lo_mm_s * speed_ratio,
        speed_hi_mm_s=estimate.speed_hi_mm_s * speed_ratio,
        x_mm=float(state[0]),
        y_mm=float(state[1]),
    )

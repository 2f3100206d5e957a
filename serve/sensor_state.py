"""What the static output says of the sensor: its drift, its attitude, and the height of its skin."""

import math

import numpy as np

from softslide.features.card import Card
from softslide.features.estimate import Estimate, Reason
from softslide.features.rest_height import rest_height
from softslide.features.stream.attitude import Attitude
from softslide.features.stream.drift import UNKNOWN, DriftWatch
from softslide.features.stream.tracker import SlideTracker

# What forbids an estimate whatever the skin's height and attitude.
_WITHOUT_REST = (Reason.DEAD_CHANNEL, Reason.UNKNOWN_ZERO)


class SensorState:
    """Of one stream: it stays what it was while nothing is at rest.

    given_mm: the skin's height; NaN: as the static output shows it. height_mm: the skin's height; NaN: not known.
    """

    def __init__(self, card: Card, given_mm: float) -> None:
        accelerometers, conditioning = card.sensor["accelerometers"], card.conditioning
        static_v, scale = () if card.contact is None else card.contact.static_v, conditioning.scale
        self._drift = DriftWatch(accelerometers, conditioning.touch_axes, scale)
        self._rest_height = rest_height(card.contact, card.heights, accelerometers, scale)
        self._attitude = None
        if card.base is None:
            self._attitude = Attitude(accelerometers, static_v, scale, card.heights is not None)
        self._given_mm = given_mm
        self.reset()

    def reset(self) -> None:
        """Forgets the stream."""
        self._drift.reset()
        self._last_drift, self._forbids, self.height_mm = UNKNOWN, Reason.NONE, self._given_mm

    def note(self, tracker: SlideTracker) -> None:
        """Keeps the first static output of each accelerometer."""
        if not self._drift.complete:
            self._drift.note(tracker.static, tracker.known)

    def read(self, tracker: SlideTracker, in_use: np.ndarray, healthy: np.ndarray) -> bool:
        """Reads the static output; whether it shows a height. in_use: (A,) accelerometers to read the drift from."""
        self._last_drift = self._drift.read(tracker.static, in_use)
        usable = tracker.known & healthy
        if not usable.any():
            return False
        if self._attitude is not None:
            if self._attitude.is_other(tracker.static, usable):
                self._forbids = Reason.ATTITUDE
                return False
            if self._attitude.may_be_touched(tracker.static, usable, tracker.static_output.rested_blocks):
                self._forbids = Reason.UNKNOWN_ZERO
                return False
        if self._forbids in (Reason.ATTITUDE, Reason.UNKNOWN_ZERO):
            self._forbids = Reason.NONE
        if self._rest_height is None or not math.isnan(self._given_mm) or not tracker.known.all():
            return False
        self._forbids = Reason.SKIN_HEIGHT if self._rest_height.is_other(tracker.static) else Reason.NONE
        self.height_mm = self._rest_height.height_mm(tracker.static)
        return True

    def mark(self, estimate: Estimate) -> Estimate:
        """The estimate with the sensor's drift and height; not valid where the static output forbids it."""
        if self._forbids is not Reason.NONE and estimate.reason not in _WITHOUT_REST:
            estimate = estimate._replace(valid=False, reason=self._forbids)
        return estimate._replace(**self._last_drift._asdict(), skin_height_mm=self.height_mm)

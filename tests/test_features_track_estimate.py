"""From a track to an estimate, and whether it may be believed."""

import numpy as np
import pytest

from softslide.features.contact.track import ContactEvidence, Track
from softslide.features.estimate import Contact, Reason
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import TOUCH_LIMITS, TrackLimits, judged


@pytest.mark.parametrize(
    ("channels", "way_mm", "valid"), [(4, 10.0, True), (2, 10.0, False), (4, 2.0, False)]
)
def test_a_lift_is_valid_where_two_accelerometers_have_followed_the_contact(
    channels: int, way_mm: float, valid: bool
) -> None:
    """Place and gain are three numbers, an accelerometer shows two."""
    mean, covariance = np.array([3.0, 4.0, 2.0, 0.0]), 0.01 * np.eye(4)
    judgement = (1.0, 1.0, 1.0, 0.6, 0.0, 0.02, 20, way_mm)
    lifting = Track(mean, covariance, *judgement, evidence=ContactEvidence(10.0, channels))
    estimate = judged(lifting, 0.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TrackLimits())
    assert estimate.valid is valid
    assert estimate.contact is (Contact.SLIDE if valid else Contact.PRESS)


@pytest.mark.parametrize(("off_mm", "reason"), [(-0.3, Reason.NONE), (-1.5, Reason.STRENGTH)])
def test_what_shows_less_than_any_contact_is_not_valid(off_mm: float, reason: Reason) -> None:
    """The calibration's contacts are 0.5 mm deep: one that is 1.5 mm less deep does not touch."""
    mean, covariance = np.array([5.0, 5.0, 3.0, 0.0]), 1e-4 * np.eye(4)
    track = Track(mean, covariance, 1.0, 1.0, 0.0, 1.0, off_mm, 0.1, 1, 20.0, evidence=ContactEvidence(10.0))
    found = judged(track, 1.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TrackLimits())
    assert (found.valid, found.reason) == (reason is Reason.NONE, reason)


@pytest.mark.parametrize(("triggers", "valid"), [(3.9, False), (4.1, True)])
def test_a_track_of_a_weak_output_is_too_early(triggers: float, valid: bool) -> None:
    mean, covariance = np.array([5.0, 5.0, 3.0, 0.0]), 1e-4 * np.eye(4)
    evidence = ContactEvidence(10.0, triggers=triggers)
    track = Track(mean, covariance, 1.0, 1.0, 0.0, 1.0, 0.0, 0.1, 1, 20.0, evidence=evidence)
    found = judged(track, 1.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TrackLimits())
    assert (found.valid, found.reason) == (valid, Reason.NONE if valid else Reason.TOO_EARLY)


@pytest.mark.parametrize(
    ("way_mm", "manoeuvres", "valid"), [(15.0, 0.1, True), (15.0, 0.5, False), (10.0, 0.1, False)]
)
def test_without_a_rim_a_bent_or_short_track_is_not_believed(
    way_mm: float, manoeuvres: float, valid: bool
) -> None:
    mean, covariance = np.array([1.0, 2.0, 20.0, 5.0]), np.diag([0.09, 0.09, 1.0, 1.0])
    track = Track(mean, covariance, 1.0, 1.0, 0.0, 1.0, 0.0, 0.02, 20, way_mm, manoeuvres)
    assert judged(track, 0.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TOUCH_LIMITS).valid is valid
    assert judged(track, 0.0, SlideState.SLIDE, (0.0, 0.0), 0.5, TrackLimits()).valid

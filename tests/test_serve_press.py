"""A press through a bundle over two accelerometers: valid while it is held, and silent about a tilt."""

from dataclasses import replace

import numpy as np
import pytest
from small_bundle import write_small_bundle
from streams import RATE_HZ, ZERO_V, a_sensor, pushed
from tracked_map import INFLATION, TWO_BOARDS, noisy_map, pressed

from softslide.features.estimate import Contact, Estimate, Reason
from softslide.features.stream.tracker import SlideState
from softslide.models.response_map.card import contact_calibration
from softslide.serve.localizer import Localizer

PLACE_MM = (12.0, 9.0)


@pytest.fixture(scope="module")
def localizer(tmp_path_factory: pytest.TempPathFactory) -> Localizer:
    plain = a_sensor(2)
    placed = zip(plain.accelerometers, TWO_BOARDS, strict=True)
    boards = tuple(replace(a, x_mm=x, y_mm=y) for a, (x, y) in placed)
    contact = contact_calibration(noisy_map(places=TWO_BOARDS), INFLATION)
    folder = tmp_path_factory.mktemp("bundle") / "model"
    return Localizer.load(write_small_bundle(folder, replace(plain, accelerometers=boards), contact=contact))


def held(level_v: np.ndarray) -> np.ndarray:
    """(n, 6) V: three seconds of rest, a level (4,) V that comes within 0.4 s, held for two."""
    time_s = np.arange(round(5.4 * RATE_HZ)) / RATE_HZ
    share = np.clip((time_s - 3.0) / 0.4, 0.0, 1.0)
    volts = np.tile([ZERO_V, ZERO_V, ZERO_V + 0.8], 2) + np.zeros((len(time_s), 6))
    volts[:, [0, 1, 3, 4]] += share[:, None] * level_v
    return volts + np.random.default_rng(3).normal(0.0, 5e-3, volts.shape)


def test_a_press_is_valid_as_long_as_it_is_held_and_a_tilt_of_the_device_is_not_a_press(
    localizer: Localizer,
) -> None:
    found = pushed(localizer, held(pressed(noisy_map(places=TWO_BOARDS), PLACE_MM)))
    valid = [e for e in found if e.valid]
    assert len(valid) > 30
    assert {e.contact for e in valid} == {Contact.PRESS}
    assert max(np.hypot(e.x_mm - PLACE_MM[0], e.y_mm - PLACE_MM[1]) for e in valid) < 1.5
    assert min(e.time_s for e in valid) > 3.0
    found = pushed(localizer, held(np.array([0.1, 0.06, 0.1, 0.06])))
    assert not any(e.valid for e in found)
    why = {Reason.AMBIGUOUS, Reason.TOO_EARLY, Reason.NOT_THIS_SENSOR, Reason.NO_CONTACT}
    assert {e.reason for e in found[-50:]} <= why


def test_a_press_that_a_straight_slide_explains_to_the_noise_is_ambiguous(localizer: Localizer) -> None:
    """The first of a slow slide far from the boards grows as a press does. One that explains it worse says nothing."""
    pushed(localizer, held(pressed(noisy_map(places=TWO_BOARDS), PLACE_MM)))
    slide = Estimate(
        5.4, SlideState.SLIDE, 30.0, speed_mm_s=2.0, reason=Reason.AMBIGUOUS, contact=Contact.SLIDE
    )
    for misfit, reason in ((0.5, Reason.AMBIGUOUS), (1.5, Reason.NONE)):
        found = localizer._contact.estimate(slide._replace(misfit=misfit), 5.4, True)
        assert found is not None
        assert (found.contact, found.reason, found.valid) == (Contact.PRESS, reason, reason is Reason.NONE)

"""The stage's motion: distance is the integral of speed, which keeps the commanded speed, ramps and travel."""

import numpy as np
import pytest

from softslide.pipeline.recordings.stroke import stage_motion

TRAVEL_MM = 30.0


@pytest.mark.parametrize("speed_mm_s", [0.5, 8.0, 40.0])
@pytest.mark.parametrize("ramp_s", [0.0, 0.2, 2.0])
def test_distance_is_the_integral_of_speed(speed_mm_s: float, ramp_s: float) -> None:
    duration_s = TRAVEL_MM / speed_mm_s + ramp_s
    time_s = np.linspace(-0.5, duration_s + 0.5, 200_001)
    travelled, speed = stage_motion(time_s, TRAVEL_MM, speed_mm_s, duration_s)
    assert (travelled[0], travelled[-1]) == (0, TRAVEL_MM)
    if ramp_s:  # the second half mirrors the first
        np.testing.assert_allclose(travelled + travelled[::-1], TRAVEL_MM)
        np.testing.assert_allclose(speed, speed[::-1], atol=1e-9)
    step = time_s[1] - time_s[0]
    integral = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2) * step])
    assert np.abs(integral - travelled).max() < 1.1 * speed_mm_s * step
    # A stroke shorter than its ramps does not reach the commanded speed.
    assert speed.max() == pytest.approx(min(speed_mm_s, TRAVEL_MM / max(ramp_s, 1e-6)), rel=1e-3)
    assert np.count_nonzero(np.abs(np.diff(travelled)) > 1.1 * speed_mm_s * step) == 0


def test_labels_that_leave_no_time_for_a_ramp_give_steady_speed() -> None:
    travelled, speed = stage_motion(np.array([1.0, 2.0]), 30.0, 6.0, 5.0)
    assert travelled == pytest.approx([6.0, 12.0], abs=1e-5)
    assert list(speed) == [6.0, 6.0]

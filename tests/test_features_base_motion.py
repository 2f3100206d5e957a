"""The base's motion taken out: exact for small contacts in any attitude, refused where the skin leans over too far."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from moving_robot import exact_motion, felt_g, on_a_robot
from streams import GRAVITY_V, ZERO_V, a_sensor

from softslide.features.base_motion import LEAST_SHARE, BaseMotion

SENSOR = a_sensor(2)
MOTION = exact_motion(SENSOR)
TILTS = st.tuples(*[st.floats(-0.2, 0.2)] * 4)


def tilted(tilts: tuple[float, ...]) -> np.ndarray:
    """(1, 6) V on a table of boards that lean by these angles (rad) about x and y."""
    leans = np.reshape(tilts, (2, 2))
    felt = np.column_stack([leans, np.sqrt(1.0 - np.sum(leans**2, axis=1))])
    return (ZERO_V + GRAVITY_V * felt).reshape(1, 6)


@given(TILTS, st.floats(-40.0, 40.0), st.floats(-40.0, 40.0))
def test_a_contact_reads_the_same_in_every_attitude(
    tilts: tuple[float, ...], roll_deg: float, pitch_deg: float
) -> None:
    table = tilted(tilts)
    felt = felt_g(np.array([roll_deg]), np.array([pitch_deg]))
    samples = on_a_robot(table, SENSOR, felt, seed=None)
    found, upright = MOTION.without(samples[:, :6], samples[:, 6:])
    assert upright.all()
    # A fifth of the noise of a block.
    assert np.abs(found - table).max() <= 2e-4


@given(hnp.arrays(float, 6, elements=st.floats(0.0, 3.3)), hnp.arrays(float, 3, elements=st.floats(0.0, 3.0)))
def test_whatever_the_outputs_are_the_answer_is_bounded(volts: np.ndarray, base_v: np.ndarray) -> None:
    """A knock, or a cable: never more than outputs and the base's motion can be, so that later blocks are right."""
    found, _ = MOTION.without(volts, base_v)
    assert np.abs(found).max() < 12.0


def test_at_rest_in_the_attitude_of_the_calibration_nothing_changes() -> None:
    table = tilted((0.05, -0.02, 0.01, 0.08))
    samples = on_a_robot(table, SENSOR, np.array([[0.0, 0.0, 1.0]]), seed=None)
    found, _ = MOTION.without(samples[:, :6], samples[:, 6:])
    assert found == pytest.approx(table, abs=1e-12)


def test_a_skin_that_leans_over_further_is_not_upright() -> None:
    angles = np.arange(0.0, 180.0, 5.0)
    felt = felt_g(angles, np.zeros_like(angles))
    samples = on_a_robot(np.repeat(tilted((0.0,) * 4), len(felt), axis=0), SENSOR, felt, seed=None)
    _, upright = MOTION.without(samples[:, :6], samples[:, 6:])
    assert (upright == (np.cos(np.deg2rad(angles)) >= LEAST_SHARE - 1e-12)[:, None]).all()


def test_what_does_not_measure_gravity_answers_alike_in_every_attitude() -> None:
    other = BaseMotion(MOTION.gains[:3], MOTION.base_v, MOTION.static_v[:3], (0.0, 0.0, 0.0))
    base_v = np.array(MOTION.base_v) + 0.2
    touched = np.array([0.1, -0.2, 0.3])
    plain, upright = other.without(np.array(MOTION.static_v[:3]), base_v)
    found, _ = other.without(np.array(MOTION.static_v[:3]) + touched, base_v)
    assert upright.all()
    assert found - plain == pytest.approx(touched)

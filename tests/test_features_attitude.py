"""What gravity shows of a sensor's attitude, and that nothing is valid in another one than the calibration's."""

import math

import numpy as np
import pytest

from softslide.features.stream.attitude import (
    MOST_FROM_Z_DEG,
    MOST_TURN_DEG,
    PROVEN_BLOCKS,
    UNPROVEN_SHARE,
    Attitude,
)

ZERO_V, SENSITIVITY = 1.65, 0.8
BOARD = {"zero_g_v": ZERO_V, "sensitivity_v_per_g": SENSITIVITY}


def at_rest(deg: float, about: float = 0.0) -> np.ndarray:
    """(3,) V of a board turned by an angle from level, about a horizontal axis at `about` degrees."""
    turn, axis = math.radians(deg), math.radians(about)
    gravity = (math.sin(turn) * math.cos(axis), math.sin(turn) * math.sin(axis), math.cos(turn))
    return ZERO_V + SENSITIVITY * np.array(gravity)


@pytest.mark.parametrize("scale", [1.0, 5.0])
@pytest.mark.parametrize("calibrated_deg", [0.0, 12.0, 180.0])
def test_a_turn_is_from_the_calibrated_attitude(scale: float, calibrated_deg: float) -> None:
    attitude = Attitude([BOARD], (scale * at_rest(calibrated_deg)).tolist(), scale)
    usable = np.array([True])
    assert not attitude.is_other(scale * at_rest(calibrated_deg), usable)
    assert not attitude.is_other(scale * at_rest(calibrated_deg + 0.9 * MOST_TURN_DEG), usable)
    assert attitude.is_other(scale * at_rest(calibrated_deg + 1.1 * MOST_TURN_DEG), usable)
    assert attitude.is_other(scale * at_rest(calibrated_deg + 180.0), usable)


def test_where_the_calibrations_is_not_known_it_is_from_the_z_axis() -> None:
    attitude, usable = Attitude([BOARD], (), 1.0), np.array([True])
    assert not attitude.is_other(at_rest(0.9 * MOST_FROM_Z_DEG, 30.0), usable)
    assert attitude.is_other(at_rest(1.1 * MOST_FROM_Z_DEG, 30.0), usable)
    wire_of_v_z_at_0_v = at_rest(0.0) * [1.0, 1.0, 0.0]
    assert attitude.is_other(wire_of_v_z_at_0_v, usable)


def test_accelerometers_that_are_not_in_use_and_other_elements_are_not_asked() -> None:
    magnetometer = {"kind": "magnetometer"}
    attitude = Attitude([BOARD, BOARD, magnetometer], (), 1.0)
    static = np.concatenate([at_rest(0.0), at_rest(90.0), np.zeros(3)])
    assert attitude.is_other(static, np.array([True, True, True]))
    assert not attitude.is_other(static, np.array([True, False, True]))


def test_outputs_without_gravity_show_no_attitude() -> None:
    assert not Attitude([BOARD], (), 1.0).is_other(np.full(3, ZERO_V), np.array([True]))


def test_far_from_the_calibrations_attitude_an_output_has_to_rest_for_longer() -> None:
    """A stream may begin on a contact that moves slowly."""
    attitude, usable = Attitude([BOARD], at_rest(0.0).tolist(), 1.0), np.array([True])
    near, far = (share * UNPROVEN_SHARE * MOST_TURN_DEG for share in (0.9, 1.1))
    for turn_deg, blocks, touched in (
        (near, 15, False),
        (far, 15, True),
        (far, PROVEN_BLOCKS - 1, True),
        (far, PROVEN_BLOCKS, False),
    ):
        assert attitude.may_be_touched(at_rest(turn_deg), usable, np.array([blocks])) is touched
    # Zeros that have all drifted by 50 mV turn gravity as far, and make it longer.
    assert not attitude.may_be_touched(at_rest(0.0) + 0.05, usable, np.array([15]))

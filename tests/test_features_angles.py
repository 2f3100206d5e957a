"""Signed differences of angles, and the channels that show a tilt."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from features.angles import tilt_channels, wrapped_deg


@given(st.integers(-180, 179), st.integers(-5, 5))
def test_whole_turns_do_not_change_a_wrapped_angle(angle: int, turns: int) -> None:
    assert wrapped_deg(float(angle + 360 * turns)) == angle


@pytest.mark.parametrize(
    ("there", "here", "wanted"), [(10.0, 350.0, 20.0), (350.0, 10.0, -20.0), (180.0, 0.0, -180.0)]
)
def test_a_difference_of_directions_takes_the_shorter_way(there: float, here: float, wanted: float) -> None:
    assert wrapped_deg(there - here) == wanted
    assert wrapped_deg(np.array([there - here])) == [wanted]


def test_tilt_channels_are_all_but_every_third() -> None:
    assert tilt_channels(6).tolist() == [0, 1, 3, 4]

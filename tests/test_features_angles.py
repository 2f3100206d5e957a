"""Signed differences of angles, and the channels that show a tilt."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from softslide.features.angles import tilt_channels, wrapped_deg


@given(st.integers(-180, 179), st.integers(-5, 5))
def test_whole_turns_do_not_change_a_wrapped_angle(angle: int, turns: int) -> None:
    assert wrapped_deg(float(angle + 360 * turns)) == angle
    assert wrapped_deg(np.array([angle + 360.0 * turns])) == [angle]


def test_tilt_channels_are_all_but_every_third() -> None:
    assert tilt_channels(6).tolist() == [0, 1, 3, 4]

"""A contact that has left the skin stays where it left."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softslide.features.departure import held_at_rim
from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState

CHAMBER_MM = (50.0, 40.0)
BALL_MM = 6.0
DEPTH_MM = 0.5
# 0.5 mm deep, a ball of 3 mm radius touches a circle of this radius.
TOUCHES_MM = math.sqrt(3.0**2 - 2.5**2)


def estimated(x_mm: float, y_mm: float, heading_deg: float, speed_mm_s: float = 2.0) -> Estimate:
    heading = math.radians(heading_deg)
    return Estimate(
        1.0,
        SlideState.SLIDE,
        depth_mm=DEPTH_MM,
        x_mm=x_mm,
        y_mm=y_mm,
        valid=True,
        vx_mm_s=speed_mm_s * math.cos(heading),
        vy_mm_s=speed_mm_s * math.sin(heading),
        x_lo_mm=x_mm - 1.0,
        x_hi_mm=x_mm + 2.0,
        y_lo_mm=y_mm - 3.0,
        y_hi_mm=y_mm + 4.0,
    )


@given(st.floats(-0.9, 0.9), st.floats(-0.9, 0.9), st.floats(0, 360), st.floats(0.0, 60.0))
def test_a_contact_on_any_line_goes_on_to_the_border_and_no_further(
    x: float, y: float, heading_deg: float, way_mm: float
) -> None:
    """From inside: unchanged while over the skin, then held on the border, on its own line, with its intervals."""
    border = np.array(CHAMBER_MM) / 2 + TOUCHES_MM
    inside = np.array([x, y]) * border
    along = np.array([math.cos(math.radians(heading_deg)), math.sin(math.radians(heading_deg))])
    place = inside + way_mm * along
    before = estimated(*place, heading_deg)
    after = held_at_rim(before, CHAMBER_MM, BALL_MM)
    if (np.abs(place) <= border).all():
        assert after is before
        return
    held = np.array([after.x_mm, after.y_mm])
    assert after.state is SlideState.ENDED
    assert np.abs(held / border).max() == pytest.approx(1.0)
    assert (held - inside) @ [-along[1], along[0]] == pytest.approx(0.0, abs=1e-6)
    assert 0.0 <= (held - inside) @ along <= way_mm
    assert (after.x_hi_mm - after.x_mm, after.y_mm - after.y_lo_mm) == pytest.approx((2.0, 3.0))
    assert after[2:11] == before[2:11]


def test_what_comes_in_passes_by_or_has_no_place_or_motion_is_left_alone() -> None:
    passing = (estimated(-27.0, 3.0, 0.0), estimated(30.0, 23.0, 0.0), estimated(24.0, 30.0, 170.0))
    for one in (*passing, estimated(math.nan, math.nan, 0.0), estimated(40.0, 0.0, 0.0, speed_mm_s=0.0)):
        assert held_at_rim(one, CHAMBER_MM, BALL_MM) is one


def test_a_ball_or_depth_that_is_not_known_leaves_at_the_rim() -> None:
    assert held_at_rim(estimated(30.0, 0.0, 0.0), CHAMBER_MM, 0.0).x_mm == pytest.approx(25.0)
    shallow = estimated(30.0, 0.0, 0.0)._replace(depth_mm=math.nan)
    assert held_at_rim(shallow, CHAMBER_MM, BALL_MM).x_mm == pytest.approx(25.0)

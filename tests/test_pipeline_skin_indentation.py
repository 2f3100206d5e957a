"""Skin height from static output, and where and how hard something rests on the skin."""

from dataclasses import replace

import numpy as np
import pytest
from article_skin import ATLAS

from softslide.features.errors import InputError
from softslide.pipeline.atlas.static_contact import find_indentation, height_by_atlas, height_by_formula


def test_formula_is_a_parabola_s_height():
    height, half, place = 7.0, 25.0, 5.0
    slope = 2 * place * height / half**2
    assert height_by_formula(np.sin(np.arctan(slope)), place, half) == pytest.approx(height)
    with pytest.raises(InputError, match="centre"):
        height_by_formula(0.1, 0.0, half)
    with pytest.raises(InputError, match="not a tilt"):
        height_by_formula(1.2, 5.0, half)


def test_atlas_knows_the_height_better_than_the_formula():
    for level, solved in zip(ATLAS.pressure_mpa[1:-1], ATLAS.height_mm[1:-1], strict=True):
        static = ATLAS.static(float(level))
        formula = height_by_formula(static[0, 0], 5.0, 25.0)
        better = height_by_atlas(static[:, :2], ATLAS)
        assert abs(better / solved - 1) < 0.005
        assert abs(better / solved - 1) < abs(formula / solved - 1) < 0.3
    with pytest.raises(InputError, match="outside the atlas's heights"):
        height_by_atlas(np.array([[0.9, 0.0]]), ATLAS)


@pytest.mark.parametrize("place", [(-6.0, 4.0, 0.4), (12.0, -7.0, 0.9), (3.0, 10.0, 0.6)])
def test_indentation_is_found_where_it_is(place):
    level = ATLAS.pressure_at(7.0)
    x, y, depth = place
    reading = ATLAS.response(np.array([x]), np.array([y]), None, depth, level)[0]
    found = find_indentation(reading, ATLAS, level)
    again = ATLAS.response(np.array([found.x_mm]), np.array([found.y_mm]), None, found.depth_mm, level)[0]
    assert np.abs(again - reading).max() < 1e-4
    assert np.hypot(found.x_mm - x, found.y_mm - y) < 1.0
    force = ATLAS.force(np.array([x]), np.array([y]), None, depth, level)[0, 2]
    assert found.force_n == pytest.approx(force, rel=0.2)
    with pytest.raises(InputError, match="shape"):
        find_indentation(reading[0], ATLAS, level)


def test_a_height_that_was_asked_for_is_in_the_atlas_that_was_solved_for_it():
    """It is solved to within a thousandth of a millimetre."""
    one = replace(ATLAS, height_mm=np.array([6.99915]), pressure_mpa=ATLAS.pressure_mpa[1:2])
    assert one.pressure_at(7.0) == ATLAS.pressure_mpa[1]
    with pytest.raises(InputError, match="outside"):
        one.pressure_at(7.01)

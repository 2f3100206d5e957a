"""scikit-learn's own estimator checks, none expected to fail, and how the estimators stand in its pipelines."""

import doctest

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.utils.estimator_checks import parametrize_with_checks
from slide_windows import labelled_slides

import softslide.sklearn
from softslide.features.vector.feature_vector import feature_names
from softslide.models.classical.interpolation import DIRECTIONS_DEG
from softslide.sklearn import AxisInterpolation, SlideRegressor, WindowFeatures, flat_windows, split_rows

# The checks' tables have 1 to 30 columns: `pad` reads them as windows of which most channels are not wired.
ESTIMATORS = [
    WindowFeatures(narrow="pad"),
    AxisInterpolation("speed", narrow="pad"),
    AxisInterpolation("distance", narrow="pad"),
    *(SlideRegressor(quantity, Ridge(1.0), narrow="pad") for quantity in ("direction", "speed", "offset")),
]


@parametrize_with_checks(ESTIMATORS)
def test_sklearn_checks(estimator, check):
    check(estimator)


SLIDES = labelled_slides(DIRECTIONS_DEG, np.array([-12.0, -9.0, -6.0, -3.0, 3.0, 6.0, 9.0, 12.0]))
ROWS = flat_windows(SLIDES.volts, SLIDES.elapsed_s)


def test_rows_round_trip():
    volts, elapsed = split_rows(ROWS, 1, "refuse")
    np.testing.assert_array_equal(volts, SLIDES.volts)
    np.testing.assert_array_equal(elapsed, SLIDES.elapsed_s)


def test_a_row_of_another_width_is_refused():
    with pytest.raises(ValueError, match="193"):
        WindowFeatures().fit(ROWS[:, :-1])
    with pytest.raises(ValueError, match="385"):
        WindowFeatures(accelerometers=2).fit(ROWS)


def test_features_come_as_a_named_table():
    table = WindowFeatures().set_output(transform="pandas").fit_transform(ROWS)
    assert tuple(table.columns) == feature_names(1)


def test_in_a_pipeline():
    model = make_pipeline(WindowFeatures(), StandardScaler(), Ridge(1.0)).fit(ROWS, np.abs(SLIDES.offset_mm))
    assert model.score(ROWS, np.abs(SLIDES.offset_mm)) > 0.9


def test_speed_and_distance_are_learned():
    for quantity, target in (("speed", SLIDES.speed_mm_s), ("distance", np.abs(SLIDES.offset_mm))):
        model = clone(AxisInterpolation(quantity)).fit(ROWS, target)
        assert model.score(ROWS, target) > 0.95


def test_a_slide_of_another_speed_is_as_well_known() -> None:
    """Each window twice as long is a slide at half the speed, which the fit has not seen."""
    model = SlideRegressor("speed", Ridge(1e-3)).fit(ROWS, SLIDES.speed_mm_s)
    slower = flat_windows(SLIDES.volts, 2 * SLIDES.elapsed_s)
    np.testing.assert_allclose(model.predict(slower), model.predict(ROWS) / 2)
    np.testing.assert_allclose(model.predict(ROWS), SLIDES.speed_mm_s, rtol=0.05)


def test_direction_and_offset_are_learned() -> None:
    direction = SlideRegressor("direction").fit(ROWS, SLIDES.direction_deg).predict(ROWS)
    turn = (direction - SLIDES.direction_deg + 180) % 360 - 180
    assert np.abs(turn).max() < 15
    offset = SlideRegressor("offset")
    assert offset.fit(ROWS, SLIDES.offset_mm).score(ROWS, SLIDES.offset_mm) > 0.95


def test_undefined_is_the_mean_or_nan():
    diagonal = labelled_slides(np.array([45.0]), np.array([0.5]))
    rows = flat_windows(diagonal.volts, diagonal.elapsed_s)
    mean = AxisInterpolation().fit(ROWS, SLIDES.speed_mm_s).predict(rows)
    np.testing.assert_array_equal(mean, SLIDES.speed_mm_s.mean())
    assert np.isnan(AxisInterpolation(undefined="nan").fit(ROWS, SLIDES.speed_mm_s).predict(rows)).all()


@pytest.mark.parametrize(
    "wrong", [{"quantity": "depth"}, {"form": "cubic"}, {"undefined": "zero"}, {"narrow": "cut"}]
)
def test_unknown_choices_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        AxisInterpolation(**wrong).fit(ROWS, SLIDES.speed_mm_s)


def test_the_example_of_the_docstring_runs():
    tried = doctest.testmod(softslide.sklearn)
    assert (tried.failed, tried.attempted > 5) == (0, True)

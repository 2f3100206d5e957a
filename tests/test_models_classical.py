"""One list of contract checks for every model on features; the interpolation by the polynomials it is made of."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnxruntime as ort
import pytest
from feature_models import SMALL, small_model
from slide_windows import labelled_slides

from softslide.features.vector.energy import energy_width_s
from softslide.models.classical import interpolation, regression
from softslide.models.classical.augmentation import with_lines_between
from softslide.models.classical.fit import graph_of
from softslide.models.classical.interpolation import fit_interpolation
from softslide.models.classical.regression import float_features
from softslide.models.classical.trees import TreesConfig, fit_trees
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.windows import labelled_windows

OFFSETS = np.array([-15.0, -12.5, -10.0, -7.5, -5.0, -2.5, 2.5, 5.0, 7.5, 10.0, 12.5, 15.0])
SLIDES = labelled_slides(interpolation.DIRECTIONS_DEG, OFFSETS)
UNSEEN = labelled_slides(interpolation.DIRECTIONS_DEG, np.array([-8.4, 6.0, 11.0]), seed=1)
BENCH = Path(__file__).parents[1].parent / "shared" / "recordings" / "bench-a"


@pytest.fixture(scope="module", params=SMALL)
def case(request):
    return request.param, small_model(request.param, SLIDES), float_features(SLIDES)


def test_seeded_to_the_last_byte_and_pure(case):
    name, model, features = case
    again, before = small_model(name, SLIDES), features.copy()
    for one in (again, model, model):
        assert one.predict(features).tobytes() == again.predict(features).tobytes()
    np.testing.assert_array_equal(features, before)


def test_independent_of_batch_size(case):
    _, model, features = case
    whole = model.predict(features)
    parts = np.concatenate([model.predict(features[k : k + 1]) for k in range(20)])
    np.testing.assert_allclose(parts, whole[:20], rtol=1e-12, atol=1e-12)


def test_the_graph_says_the_same(case):
    _, model, features = case
    graph = graph_of(model, features.shape[1])
    session = ort.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    # Noise too, so that every branch is taken.
    noise = np.random.default_rng(0).normal(0, 0.1, features.shape).astype(np.float32)
    for rows in (features, features[:1], features + noise):
        exported, original = session.run(None, {"features": rows})[0], model.predict(rows)
        np.testing.assert_array_equal(np.isnan(exported), np.isnan(original))
        scale = np.nanmax(np.abs(original), axis=0, initial=1e-6)
        assert np.nanmax(np.abs(exported - original) / scale, initial=0.0) < 1e-4


@pytest.mark.parametrize("name", ["interpolation", "trees", "gp"])
def test_lines_between_the_known_ones_are_found(name):
    model = small_model(name, SLIDES)
    rows = model.predict(float_features(UNSEEN))
    column = dict(zip(model.outputs, rows.T, strict=True))
    log_speed = column.get("log_speed")
    if log_speed is None:
        log_speed = column["log_speed_width"] - np.log(energy_width_s(UNSEEN.volts, UNSEEN.elapsed_s))
    turned = np.angle(
        (column["direction_cos"] + 1j * column["direction_sin"])
        * np.exp(-1j * np.deg2rad(UNSEEN.direction_deg))
    )
    assert np.abs(np.rad2deg(turned)).max() < 15
    assert np.abs(np.exp(log_speed) / UNSEEN.speed_mm_s - 1).mean() < 0.04
    assert np.abs(column["offset_mm"] - UNSEEN.offset_mm).mean() < 0.5


def test_interpolation_abstains_on_a_diagonal_and_on_silence():
    model = fit_interpolation(SLIDES)
    assert np.isnan(
        model.predict(float_features(labelled_slides(np.array([45.0, 225.0]), np.array([0.5]))))
    ).all()
    silent = replace(UNSEEN, volts=np.zeros_like(UNSEEN.volts))
    assert np.isnan(model.predict(float_features(silent))).all()


def test_interpolation_abstains_beyond_the_detectable_area():
    wide = labelled_slides(interpolation.DIRECTIONS_DEG, np.linspace(-24.0, 24.0, 17))
    rows = fit_interpolation(wide).predict(float_features(wide))
    assert np.isfinite(rows[np.abs(wide.offset_mm) < 15]).all()
    across_x = (wide.direction_deg % 180 == 0) & (np.abs(wide.offset_mm) > 20)
    assert not (np.abs(rows[across_x, 3]) > 19.0).any()


def test_interpolation_returns_the_polynomials_it_was_given():
    t = np.linspace(2.0, 40.0, 30)
    abscissa = np.broadcast_to(t[:, None, None], (30, 4, 2))
    seen = np.ones((30, 4, 2), bool)
    published = 0.008 * t**2 - 0.4331 * t + 7.4336
    found = interpolation.fit_polynomials(abscissa, seen, published, 2, np.ones(30))
    np.testing.assert_allclose(found.coefficients[0, 1], [7.4336, -0.4331, 0.008], rtol=1e-9)
    value = interpolation.evaluate_polynomials(found, abscissa, seen)
    np.testing.assert_allclose(value, np.broadcast_to(published[:, None], (30, 4)), rtol=1e-9)


def test_an_extreme_that_has_not_passed_is_not_used():
    polynomials = interpolation.Polynomials(np.array([[[0.0, 1.0], [100.0, 0.0]]] * 4), np.ones((4, 2)))
    abscissa = np.full((1, 4, 2), 3.0)
    only_first = np.zeros((1, 4, 2), bool)
    only_first[..., 0] = True
    np.testing.assert_array_equal(interpolation.evaluate_polynomials(polynomials, abscissa, only_first), 3.0)
    assert np.isnan(
        interpolation.evaluate_polynomials(polynomials, abscissa, np.zeros_like(only_first))
    ).all()


def test_lines_between_lie_between():
    features, target = float_features(SLIDES), regression.targets(SLIDES)
    rows, goals = with_lines_between(SLIDES, features, target)
    added = goals[len(target) :]
    assert rows.dtype == features.dtype
    # 10 gaps of 2.5 mm (the one over the middle is 5 mm), 3 shares, 4 directions, 2 fractions.
    assert len(added) == 11 * 3 * 4 * 2
    np.testing.assert_allclose(np.hypot(added[:, 0], added[:, 1]), 1.0, atol=1e-12)
    assert np.abs(added[:, 3]).max() < 15.0


def test_no_label_is_seen_by_a_window_or_its_features():
    folder = read_folder(SAMPLE).select("calibration")
    some = replace(folder, manifest=folder.manifest.iloc[:4])
    windows = labelled_windows(some, fractions=(0.5, 1.0))
    assert windows.volts.dtype == np.float32
    assert len(windows) == len(windows[windows.elapsed_s > 0])
    lied = some.manifest.assign(direction_deg=1.0, speed_mm_s=9.0, offset_mm=0.0, travel_mm=1.0)
    blind = labelled_windows(replace(some, manifest=lied), fractions=(0.5, 1.0))
    assert blind.volts.tobytes() == windows.volts.tobytes()
    assert blind.elapsed_s.tobytes() == windows.elapsed_s.tobytes()
    assert float_features(blind).tobytes() == float_features(windows).tobytes()


def test_position_along_the_line_follows_the_motion():
    folder = read_folder(SAMPLE).select("calibration")
    windows = labelled_windows(replace(folder, manifest=folder.manifest.iloc[:3]), fractions=(0.5, 1.0))
    for name in np.unique(windows.recording):
        half, whole = windows[windows.recording == name].along_mm
        assert whole - half == pytest.approx(0.5 * folder.manifest.at[name, "travel_mm"])


@pytest.mark.long
@pytest.mark.skipif(not BENCH.is_dir(), reason="the bench recordings are not here")
def test_trees_on_the_bench_reach_half_a_percent_and_a_fifth_of_a_millimetre():
    folder = read_folder(BENCH)
    model = fit_trees(labelled_windows(folder.select("calibration")), TreesConfig())
    test = replace(folder, manifest=folder.manifest[folder.manifest["split"].isin(["test", "test-fast"])])
    windows = labelled_windows(test, fractions=(1.0,))
    error = model.predict(float_features(windows)) - regression.targets(windows)
    assert np.abs(np.expm1(error[:, 2])).mean() < 0.005
    assert np.abs(error[:, 3]).mean() < 0.2

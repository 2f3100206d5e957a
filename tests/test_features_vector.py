"""Laws of the feature vector: what time, strength and mirrors must do to it, and nothing else."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from slide_windows import slide_window

from softslide.features.vector.arc import arc_curve
from softslide.features.vector.energy import energy_clock, energy_width_s
from softslide.features.vector.extrema import maximum, minimum, value_at
from softslide.features.vector.feature_vector import feature_matrix, feature_names, feature_vector
from softslide.features.vector.zones import signs, zone, zones_in_order

NAMES = np.array(feature_names(1))
SECONDS = np.char.endswith(NAMES, "_s")
VOLTS = np.char.endswith(NAMES, "_v")
# Multiples of 2^-10 V, as a converter gives them: their sums are exact, so no sign hangs on rounding.
windows = arrays(np.float64, (3, 64), elements=st.integers(-1000, 1000).map(lambda k: k / 1024))


def column(name: str) -> int:
    return int(np.flatnonzero(name == NAMES)[0])


@given(windows, st.floats(0.01, 100.0))
@settings(max_examples=60)
def test_stretching_time_scales_seconds_and_nothing_else(volts, factor):
    once, stretched = feature_vector(volts, 2.0), feature_vector(volts, 2.0 * factor)
    np.testing.assert_allclose(stretched[SECONDS], factor * once[SECONDS], rtol=1e-12)
    np.testing.assert_array_equal(stretched[~SECONDS], once[~SECONDS])


@given(windows, st.integers(-6, 6))
@settings(max_examples=60)
def test_scaling_voltages_scales_volts_and_nothing_else(volts, power):
    # A power of two: an exact factor, so that thresholds at equality fall alike.
    once, scaled = feature_vector(volts, 2.0), feature_vector(volts * 2.0**power, 2.0)
    np.testing.assert_allclose(scaled[VOLTS], 2.0**power * once[VOLTS], rtol=1e-12, atol=0)
    np.testing.assert_allclose(scaled[~VOLTS], once[~VOLTS], rtol=1e-12, atol=1e-15)


@given(st.floats(-15, 15), st.sampled_from([0.0, 37.0, 90.0, 180.0, 211.0, 300.0]), st.floats(0.5, 1.0))
@settings(max_examples=60)
def test_mirror_in_y_swaps_and_flips_what_it_must(offset, direction, stroke):
    volts = slide_window(direction, offset, stroke=stroke)
    there = feature_vector(volts * np.array([[1.0], [-1.0], [1.0]]), 2.0)
    here = feature_vector(volts, 2.0)
    for unit in ("v", "s", "fraction", "widths"):
        sign = -1.0 if unit == "v" else 1.0
        assert there[column(f"a0_vy_min_{unit}")] == sign * here[column(f"a0_vy_max_{unit}")]
        assert there[column(f"a0_vx_min_{unit}")] == here[column(f"a0_vx_min_{unit}")]
    assert there[column("a0_vy_at_vx_min_v")] == -here[column("a0_vy_at_vx_min_v")]
    assert there[column("a0_vy_sign_last")] == -here[column("a0_vy_sign_last")]
    swapped = {0.0: 0.0, 1.0: 3.0, 2.0: 4.0, 3.0: 1.0, 4.0: 2.0}
    for k in (1, 2, 3):
        assert there[column(f"a0_zone_{k}")] == swapped[here[column(f"a0_zone_{k}")]]
    curve = np.char.startswith(NAMES, "a0_vy_arc") & VOLTS
    np.testing.assert_array_equal(there[curve], -here[curve])
    for name in ("energy_width_s", "energy_centre_s", "a0_rms_v", "a0_arc_length_v"):
        assert there[column(name)] == here[column(name)]


def test_batch_and_single_agree_to_the_last_bit():
    volts = np.random.default_rng(0).normal(0, 0.05, (301, 6, 64)).astype(np.float32)
    elapsed = np.linspace(0.3, 90, 301)
    batch = feature_matrix(volts, elapsed)
    assert batch.shape == (301, len(feature_names(2)))
    for k in (0, 1, 255, 256, 300):
        np.testing.assert_array_equal(feature_vector(volts[k], elapsed[k]), batch[k])
    np.testing.assert_array_equal(feature_matrix(volts[7:30], elapsed[7:30]), batch[7:30])


def test_names_are_distinct_and_features_of_a_silent_window_finite():
    assert len(set(feature_names(3))) == len(feature_names(3))
    assert np.isfinite(feature_vector(np.zeros((3, 64)), 1.0)).all()


def test_malformed_windows_are_refused():
    with pytest.raises(ValueError, match="shape"):
        feature_matrix(np.zeros((2, 4, 64)), np.ones(2))
    with pytest.raises(ValueError, match="elapsed_s"):
        feature_matrix(np.zeros((2, 3, 64)), np.ones(3))


def test_a_parabolas_vertex_is_found_and_an_extreme_at_the_edge_stays_there():
    u = (np.arange(64) + 0.5) / 64
    for vertex in (0.2, 0.4137, 0.77):
        value, moment = maximum(0.2 - 3.0 * (u - vertex) ** 2)
        assert value == pytest.approx(0.2, abs=1e-12)
        assert moment == pytest.approx(vertex, abs=1e-12)
        assert minimum(3.0 * (u - vertex) ** 2 - 0.2)[1] == pytest.approx(vertex, abs=1e-12)
    assert tuple(maximum(np.linspace(0.0, 1.0, 64))) == (1.0, 63.5 / 64)


def test_the_extreme_converges_with_the_third_order_at_least_of_the_bin():
    def wave(u):
        return np.exp(-20.0 * u**2) * (1.0 + u)

    truth = wave(np.linspace(-0.1, 0.2, 300_001)).max()

    def errors(bins):
        u = (np.arange(bins) + 0.5) / bins
        waves = wave(u - 0.45 - np.arange(40)[:, None] / (40 * bins))
        return np.array([np.abs(waves.max(axis=-1) - truth).max(), np.abs(maximum(waves)[0] - truth).max()])

    plain, refined = np.log2(errors(64) / errors(128))
    # The plain maximum leaves h^2 f'' behind, the parabola h^3 f''', which is small near a symmetric peak.
    assert plain == pytest.approx(2.0, abs=0.2)
    assert refined > 2.8


def test_value_at_is_exact_on_a_line():
    u = (np.arange(64) + 0.5) / 64
    moments = np.array([u[0], 0.31, 0.5, u[-1]])
    np.testing.assert_allclose(value_at(np.tile(2 * u - 1, (4, 1)), moments), 2 * moments - 1, atol=1e-14)


def test_energy_width_of_a_gaussian():
    u = (np.arange(64) + 0.5) / 64
    bump = np.exp(-((u - 0.5) ** 2) / (4 * 0.1**2))
    centre, width = energy_clock(np.stack([bump, np.zeros(64)]))
    assert centre == pytest.approx(0.5, abs=1e-12)
    assert width == pytest.approx(0.1, rel=2e-3)
    assert energy_width_s(np.stack([bump, 0 * bump, 0 * bump]), np.float64(3.0)) == 3.0 * width


ALONG_X = [(0, -6, (1, 2)), (180, 6, (2, 1)), (0, 6, (3, 4)), (180, -6, (4, 3))]
ALONG_Y = [(90, 6, (1, 3)), (270, -6, (3, 1))]


@pytest.mark.parametrize(("direction", "offset", "order"), [*ALONG_X, *ALONG_Y])
def test_zones_of_the_article_in_order(direction, offset, order):
    sign = signs(slide_window(direction, offset)[:2])
    zones, entered = zones_in_order(zone(sign), 3)
    assert tuple(zones) == (*order, 0)
    assert 0 <= entered[0] < entered[1] < entered[2] == 1


def test_noise_within_the_dead_band_changes_no_zone():
    tilt = slide_window(0, 6)[:2]
    tail = 0.02 * np.abs(tilt).max() * np.tile([[1.0, -1.0], [-1.0, 1.0]], 32)
    longer = np.concatenate([tilt, tail], axis=1)
    assert tuple(zones_in_order(zone(signs(longer)), 3)[0]) == (3, 4, 0)


@pytest.mark.parametrize("warp", [-0.6, 0.5])
def test_the_arc_curve_does_not_depend_on_the_motion_along_the_path(warp):
    def gap(bins):
        even, _ = arc_curve(slide_window(20.0, 5.0, bins)[:2])
        bent, _ = arc_curve(slide_window(20.0, 5.0, bins, warp)[:2])
        return np.abs(even - bent).max() / np.abs(even).max()

    assert gap(64) < 0.03
    # What is left is the bins' width: it goes as they narrow.
    assert gap(512) < gap(64) / 4


def test_arc_points_are_evenly_spaced():
    # Straight from (0, 0) to (3, 4), in uneven steps; smoothing keeps a line a line.
    u = np.sort(np.random.default_rng(1).uniform(0, 1, 64))
    curve, length = arc_curve(np.stack([3 * u, 4 * u]))
    steps = np.hypot(*np.diff(curve, axis=-1))
    np.testing.assert_allclose(steps, length / 15, rtol=1e-9)


def test_five_thousand_windows_a_second():
    volts, elapsed = np.tile(slide_window(10.0, 3.0), (4000, 1, 1)), np.ones(4000)
    feature_matrix(volts[:300], elapsed[:300])
    begun = time.process_time()
    feature_matrix(volts, elapsed)
    assert len(volts) / (time.process_time() - begun) > 5000

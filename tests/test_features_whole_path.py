"""Paths of whole contacts: derivatives, laws of the splines, exact paths found again, intervals that hold."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from dome_map import CHAMBER_MM, dome_map, surface_of
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from softslide.features.contact.hypotheses import LocalErrors
from softslide.features.whole_contact.curve import Curve, curve_along, spline_basis
from softslide.features.whole_contact.first_places import GRID_MM, Measured, first_places, whitening
from softslide.features.whole_contact.whole_path import LEAST_BLOCKS, PathConfig, WholePath, whole_path

BLOCK_S = 0.02
RESPONSE = dome_map(2, floor_v=4e-3)
SURFACE = surface_of(RESPONSE)
CONFIG = PathConfig()


def curve(seed: int) -> Curve:
    draw = np.random.default_rng(seed)
    basis = spline_basis(np.linspace(0.0, 1.0, 41), 4)
    start, log_speed = draw.normal(0.0, 3.0, 2), np.log(25.0) + draw.normal(0.0, 0.2, 7)
    return Curve(basis, BLOCK_S / 2, start, log_speed, draw.uniform(-3, 3) + draw.normal(0.0, 0.4, 7), 1.0)


def measured(place: np.ndarray, gain: float = 1.0, seed: int | None = None) -> Measured:
    """Blocks at places (m, 2) mm; seed: with the errors that the fit expects, None: exact."""
    draw = np.random.default_rng(seed)
    noisy = 0.0 if seed is None else 1.0
    felt = place + noisy * CONFIG.local.place_mm * draw.standard_normal(place.shape)
    size = gain * (1 + noisy * CONFIG.local.gain * draw.standard_normal((len(place), 1)))
    volts = size * SURFACE.at(*felt.T)[:, 0, 0]
    floor = RESPONSE.floor_v * np.ones(SURFACE.channels)
    volts = volts + noisy * floor * draw.standard_normal(volts.shape)
    return Measured(volts, floor**2, BLOCK_S, RESPONSE.gain_sd, (CHAMBER_MM[0] / 2, CHAMBER_MM[1] / 2))


def winding(seed: int) -> np.ndarray:
    """At every half block: x, y, vx, vy of a contact that bends one way, then the other, and grows faster."""
    draw = np.random.default_rng(seed)
    time = np.arange(121) * BLOCK_S / 2
    phase, bend = draw.uniform(0, 6.28), draw.uniform(0.3, 0.9)
    heading = draw.uniform(0, 6.28) + bend * np.sin(8.0 * time + phase)
    speed = 14.0 * np.exp(draw.uniform(-0.4, 0.4) * time)
    velocity = speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    between = (velocity[1:] + velocity[:-1]) * BLOCK_S / 4
    place = np.concatenate([np.zeros((1, 2)), between.cumsum(axis=0)])
    return np.concatenate([place - place.mean(axis=0), velocity], axis=1)


def apart_mm(path: WholePath, true: np.ndarray) -> np.ndarray:
    """(m,) mm between the path and the true one, which has every half block."""
    return np.hypot(*(path.mean - true[2::2])[:, :2].T)


def turned_rad(path: WholePath, true: np.ndarray) -> np.ndarray:
    """(m,): how far its heading is off."""
    cross = path.mean[:, 2] * true[2::2, 3] - path.mean[:, 3] * true[2::2, 2]
    return np.arcsin(cross / np.hypot(*path.mean[:, 2:].T) / np.hypot(*true[2::2, 2:].T))


def found(each: Measured, config: PathConfig = CONFIG) -> WholePath:
    path = whole_path(each, SURFACE, config)
    assert path is not None
    return path


@cache
def fitted(seed: int) -> WholePath:
    """Of a winding path with the errors that are expected."""
    return found(measured(winding(seed)[1::2, :2], seed=seed))


def test_splines_are_those_of_scipy_and_sum_to_one() -> None:
    at = np.linspace(0.0, 1.0, 57)
    knots = np.arange(-3, 9) / 5
    basis = spline_basis(at, 5)
    np.testing.assert_allclose(basis, BSpline.design_matrix(at, knots, 3).toarray(), atol=1e-12)
    np.testing.assert_allclose(basis.sum(1), 1.0)


@given(st.integers(0, 10**6))
def test_derivatives_of_the_motion_are_differences(seed: int) -> None:
    one = curve(seed)
    _, by = one.motion()
    for n in range(len(one.parameters)):
        step = np.zeros(len(one.parameters))
        step[n] = 1e-5
        ahead, behind = one.changed(step).motion()[0], one.changed(-step).motion()[0]
        np.testing.assert_allclose((ahead - behind) / 2e-5, by[:, :, n], atol=2e-4)


def test_a_curve_along_exact_places_passes_through_them() -> None:
    true = winding(3)
    along = curve_along(true[1::2, :2], BLOCK_S, 1.0, 2.0)
    fitted = along.motion()[0][1::2]
    assert np.hypot(*(fitted - true[1::2])[:, :2].T).max() < 0.25
    assert np.abs(np.hypot(*fitted[:, 2:].T) / np.hypot(*true[1::2, 2:].T) - 1).max() < 0.1


def test_whitened_residuals_have_the_unit_covariance() -> None:
    response = SURFACE.at(np.array([2.0, -5.0]), np.array([1.0, 7.0]))[:, :, 0]
    shown, slopes = response[:, 0], response[:, 1:]
    white, log_size = whitening(shown, slopes, np.full(6, 1e-5), LocalErrors(0.3, 0.05))
    for w, value, slope, size in zip(white, shown, slopes, log_size, strict=True):
        whole = 1e-5 * np.eye(6) + 0.3**2 * slope.T @ slope + 0.05**2 * np.outer(value, value)
        np.testing.assert_allclose(w @ whole @ w.T, np.eye(6), atol=1e-9)
        assert size == pytest.approx(np.linalg.slogdet(whole)[1])


def test_first_places_are_the_best_of_all_sequences() -> None:
    """Against all sequences of three blocks on a small skin."""
    true = np.array([[0.0, 0.0], [0.6, 0.2], [1.1, 0.6]])
    small = measured(true, seed=4)._replace(half_mm=(1.0, 1.0))
    fitted = first_places(small, SURFACE, CONFIG.local, CONFIG.step_mm)
    axis = np.arange(-1.0, 1.0 + GRID_MM / 2, GRID_MM)
    grid = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=2).reshape(-1, 2)
    response = SURFACE.at(*grid.T)[:, :, 0]
    near = LocalErrors(np.hypot(CONFIG.local.place_mm, GRID_MM / 2), np.hypot(CONFIG.local.gain, 0.1))
    white, size = whitening(response[:, 0], response[:, 1:], small.variance, near)
    gap = small.volts[:, None] - response[:, 0]
    off = 0.5 * (((white @ gap[..., None])[..., 0] ** 2).sum(2) + size)
    way = 0.5 * ((grid[:, None] - grid) ** 2).sum(2) / CONFIG.step_mm**2
    total = off[0][:, None, None] + way[:, :, None] + off[1][None, :, None] + way[None] + off[2]
    best = np.unravel_index(total.argmin(), total.shape)
    np.testing.assert_allclose(fitted, grid[list(best)])


@pytest.mark.parametrize("gain", [1.0, 0.9])
def test_an_exact_path_is_found_again(gain: float) -> None:
    """By a fit that expects small errors, so that the prior counts for little."""
    true = winding(1)
    exact = measured(true[1::2, :2], gain)._replace(variance=np.full(6, 1e-8))
    path = found(exact, replace(CONFIG, local=LocalErrors(0.02, 0.005), knot_mm=1.0))
    assert apart_mm(path, true).max() < 0.05
    assert (path.mean[:, 2:] * true[2::2, 2:]).sum(axis=1).min() > 0.0
    assert np.degrees(np.abs(turned_rad(path, true))).max() < 4.0
    assert path.gain == pytest.approx(gain, abs=0.02)
    assert path.misfit < 0.1
    assert path.way_mm == pytest.approx(np.hypot(*true[:, 2:].T).mean() * 60 * BLOCK_S, rel=0.02)


def test_intervals_hold_as_often_as_they_should() -> None:
    """Normalized by their covariances, the errors of paths with the errors that are expected."""
    squares, headings = [], []
    for seed in range(12):
        true = winding(seed)
        path = fitted(seed)
        assert 0.7 < path.misfit < 1.4
        off = (path.mean - true[2::2])[:, :2, None]
        squares += list((off * np.linalg.solve(path.covariance[:, :2, :2], off)).sum(axis=(1, 2)))
        headings += list(turned_rad(path, true))
    # The standard deviations are 1.2 of the fit's: 2 / 1.2^2 on average where the splines hold the path.
    assert 0.8 < np.mean(squares) < 2.2
    assert np.degrees(np.median(np.abs(headings))) < 5.0


def test_a_longer_contact_shows_its_middle_better_than_its_part() -> None:
    """What comes after a moment shows it."""
    off = []
    for seed in range(8):
        true = winding(seed)
        paths = found(measured(true[1::2, :2][:30], seed=seed)), fitted(seed)
        off.append([np.hypot(*(path.mean[29] - true[60])[2:]) for path in paths])
    part, whole = np.median(off, axis=0)
    assert whole < 0.7 * part


def test_blocks_that_were_not_measured_are_bridged_and_what_is_too_short_has_no_path() -> None:
    true = winding(6)
    each = measured(true[1::2, :2], seed=6)
    each.volts[20:26] = np.nan
    path = found(each)
    assert apart_mm(path, true).max() < 1.0
    assert path.covariance[23, 0, 0] > 1.5 * path.covariance[35, 0, 0]
    assert 0.7 < path.misfit < 1.4
    short, enough = (measured(true[1::2, :2][:count]) for count in (LEAST_BLOCKS - 1, LEAST_BLOCKS))
    assert whole_path(short, SURFACE, CONFIG) is None
    assert whole_path(enough, SURFACE, CONFIG) is not None


def test_the_prior_that_allows_least_is_taken_on_a_straight_line() -> None:
    """Its heading is known better than by the prior that allows most alone."""
    time = np.arange(121) * BLOCK_S / 2
    true = np.stack([-10 + 15 * time, 2 + 5 * time], axis=1)
    each = measured(true[1::2], seed=5)
    chosen = found(each)
    freest = whole_path(each, SURFACE, replace(CONFIG, steerings=CONFIG.steerings[-1:]))
    assert freest is not None
    assert chosen.covariance[30, 3, 3] < 0.5 * freest.covariance[30, 3, 3]
    assert np.degrees(np.arctan2(chosen.mean[30, 3], chosen.mean[30, 2])) == pytest.approx(18.4, abs=2.0)

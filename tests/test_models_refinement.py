"""Laws of the refinement: derivatives, fixed points, convergence, scale of time, and what its weights stand for."""

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from bump_map import REFERENCE_MM, bump_map
from dome_map import dome_map

from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.forward_model import BINS
from softslide.models.cnn.gauss_newton import (
    Refinement,
    RefinementConfig,
    bin_means,
    inverted,
)
from softslide.models.cnn.training_windows import SynthesisConfig, WindowBatch, WindowSource
from softslide.models.intervals import conformal_interval

BLOCK_S = 0.02
WHOLE = SynthesisConfig(complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0)


@pytest.fixture(scope="module")
def windows():
    return WindowSource(bump_map(), BLOCK_S, WHOLE).draw(400, torch.Generator().manual_seed(3))


def chosen(batch: WindowBatch, which) -> WindowBatch:
    return WindowBatch(*(getattr(batch, field.name)[which] for field in fields(batch)))


def refine(response, batch, start, steps=8, sd=0.5, vertical=None, cross_axis_sd=0.01):
    """heading (B, 2), state (B, 6), its variance, misfit and strain (B, 1), bends (B, 4), of one accelerometer."""
    refinement = Refinement(
        response, BLOCK_S, RefinementConfig(steps=steps, trust=1.0, cross_axis_sd=cross_axis_sd)
    )
    third = torch.zeros_like(batch.volts[:, :1]) if vertical is None else vertical
    with torch.no_grad():
        columns = refinement(
            torch.cat([batch.volts, third], 1)[:, None],
            batch.elapsed_s,
            batch.weight,
            start,
            torch.full((len(start), 4), float(np.log(sd))),
        )
    return tuple(column.flatten(1) for column in columns)


@pytest.mark.parametrize("response", [bump_map(), dome_map(2)], ids=["two axes", "three axes"])
def test_rows_are_the_map_and_its_derivatives(response):
    refinement = Refinement(response, BLOCK_S, RefinementConfig())
    state = np.array([0.3, np.log(4.0), 3.0, 8.0, 0.1, 0.2])
    heading, elapsed_s, shape = 0.7, 5.0, (response.boards, response.axes, BINS)
    start = torch.tensor([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    time = elapsed_s * refinement.ago + refinement.lag
    measured = torch.zeros(1, response.boards, response.axes, 7, BINS, dtype=torch.float64)
    measured[..., 6, :] = torch.tensor(np.random.default_rng(1).normal(0.0, 0.1, shape))

    def predicted(state: np.ndarray) -> np.ndarray:
        turn, log_speed, offset, along, gain, depth = state
        a = heading + turn
        s = along - np.exp(log_speed) * time[1].numpy()
        x = response.reference_mm[0] - offset * np.sin(a) + s * np.cos(a)
        y = response.reference_mm[1] + offset * np.cos(a) + s * np.sin(a)
        own = response.at(response.depth_mm + depth)
        return (np.exp(gain) * own.response(x, y, a).T).reshape(shape)

    one = (1, 1, 1)
    rows = refinement.predicted(
        measured,
        start.reshape(*one, 2, 2),
        torch.tensor(state).reshape(*one, 6, 1),
        time.expand(*one, 2, BINS),
    )[0].numpy()
    np.testing.assert_allclose(measured[0, :, :, 6].numpy() - rows[:, :, 6], predicted(state), atol=1e-7)
    for k, step in enumerate(1e-5 * np.eye(6)):
        numeric = (predicted(state + step) - predicted(state - step)) / 2e-5
        np.testing.assert_allclose(rows[:, :, k], numeric, atol=1e-6)


def test_bins_are_means_of_what_lies_in_them():
    """Exact for cubics inside, for parabolas in the outermost bins too."""
    edge, centre = np.arange(BINS + 1.0), np.arange(BINS) + 0.5
    for power in range(4):
        means = np.diff(edge ** (power + 1)) / (power + 1)
        inner = slice(None) if power < 3 else slice(1, -1)
        np.testing.assert_allclose((bin_means() @ centre**power)[inner], means[inner], rtol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e4, 1e-4])
def test_inverses_are_as_exact_as_their_matrices_allow(scale: float):
    """Of numbers as unlike as those of a state: a turn, a logarithm, lengths in mm."""
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(500, 1, 1, 6, 6, generator=generator, dtype=torch.float64)
    sizes = scale ** torch.linspace(0, 1, 6, dtype=torch.float64)[:, None]
    matrix = sizes * (root @ root.mT + 1e-3 * torch.eye(6)) * sizes.mT
    inverse, exact = inverted(matrix), torch.linalg.inv(matrix)
    off = (inverse - exact).abs() / exact.abs().amax((3, 4), keepdim=True)
    assert off.max() < 1e-15 * torch.linalg.cond(root @ root.mT + 1e-3 * torch.eye(6)).max()


def bending(curvature: float, change: float, slope: float) -> tuple[torch.Tensor, ...]:
    """Of a way of 20 mm at 4 mm/s that ends at the heading 0.6, 6 mm left of the reference and 9 mm
    past it: with a curvature in 1/mm, a relative change of speed in 1/s, a slope of its depth; no noise."""
    response, heading, speed, elapsed_s = bump_map(), 0.6, 4.0, 5.0
    ago = (np.arange(WINDOW_BINS * 8)[::-1] + 0.5) * elapsed_s / (WINDOW_BINS * 8)
    back = speed * (ago - change * ago**2 / 2)
    turned = heading - curvature * back
    step = np.diff(back, append=0.0)
    x = 9.0 * np.cos(heading) - 6.0 * np.sin(heading) + np.cumsum((step * np.cos(turned))[::-1])[::-1]
    y = 9.0 * np.sin(heading) + 6.0 * np.cos(heading) + np.cumsum((step * np.sin(turned))[::-1])[::-1]
    place = REFERENCE_MM[0] + x, REFERENCE_MM[1] + y, turned
    flat, deeper = (response.at(response.depth_mm + more).response(*place) for more in (0.0, 0.1))
    touch = flat + (deeper - flat) * (-slope * back / 0.1)[:, None]
    volts = np.concatenate([touch, np.zeros((len(touch), 1))], 1).reshape(WINDOW_BINS, 8, 3).mean(1).T
    line = [np.cos(heading), np.sin(heading), np.log(speed), 6.0, 9.0]
    refinement = Refinement(response, BLOCK_S, RefinementConfig(steps=8, trust=1.0))
    given = [
        torch.tensor(np.array(v), dtype=torch.float32)
        for v in (volts[None, None], [elapsed_s], [[1.0]], [line])
    ]
    with torch.no_grad():
        return refinement(*given, torch.full((1, 4), float(np.log(0.5))))


@pytest.mark.parametrize(
    ("curvature", "change", "slope"), [(0.02, 0, 0), (-0.02, 0, 0), (0, 0.15, 0), (0, -0.1, 0), (0, 0, 0.02)]
)
def test_a_way_that_bends_or_changes_is_known_from_a_straight_one(curvature, change, slope):
    """And what the straight one errs by at its end is within what it may differ by."""
    heading, state, variance, _, _, bends = bending(curvature, change, slope)
    straight, direction, log_speed, offset = bends.flatten().tolist()
    assert straight < 0.05
    cos, sin = heading.flatten().tolist()
    errors = (
        np.angle((cos + 1j * sin) * np.exp(-0.6j)),
        float(state[0, 0, 0, 1]) - np.log(4.0),
        float(state[0, 0, 0, 2]) - 6.0,
    )
    sd = variance[0, 0, 0, :3, 0].sqrt().numpy()
    assert (np.abs(errors) < 2.0 * np.array([direction, log_speed, offset]) * sd).all()


def test_a_straight_way_is_taken_for_one():
    *_, bends = bending(0.0, 0.0, 0.0)
    straight, *wider = bends.flatten().tolist()
    assert straight > 0.95
    assert min(wider) >= 1.0


def test_weights_are_the_inverse_of_the_residuals_covariance():
    response = bump_map(level_v=5e-4, output_share=0.004, place_mm=0.08, drift_v_s=np.full(2, 3e-4))
    refinement = Refinement(response, BLOCK_S, RefinementConfig(cross_axis_sd=0.05))
    generator = torch.Generator().manual_seed(2)
    volts = 0.1 * torch.randn(1, 6, WINDOW_BINS, generator=generator, dtype=torch.float64)[:, :3]
    bins = volts.reshape(3, BINS, -1).mean(2)
    elapsed_s = torch.tensor([4.0], dtype=torch.float64)
    ripple, since_s = bins[2] - bins[2].mean(), 4.0 * (np.arange(BINS) + 0.5) / BINS
    found = refinement._inverse_covariance(
        bins[:2].reshape(1, 1, 2, 1, BINS),
        ripple.reshape(1, 1, 1, 1, BINS),
        elapsed_s,
        torch.ones(1, 1, 1, 1, 1, dtype=torch.float64),
        torch.full((1, 1, 1, 1, 1), 1.6, dtype=torch.float64),
    )[0, 0].numpy()
    alike = (
        response.noise_v[0] ** 2 / (4.0 / BLOCK_S / BINS)
        + 5e-4**2
        + (0.004 * float(bins[:2].abs().max())) ** 2
    )
    for inverse, output in zip(found, bins[:2].numpy(), strict=True):
        covariance = np.diag(alike + (0.08 / 1.6 * np.gradient(output)) ** 2)
        covariance += response.zero_v[0] ** 2 + 0.05**2 * np.outer(ripple, ripple)
        covariance += response.drift_v_s[0] ** 2 * np.outer(since_s, since_s)
        np.testing.assert_allclose(inverse @ covariance, np.eye(BINS), atol=1e-9)


def test_ripple_of_v_z_in_v_x_and_v_y_costs_little(windows):
    """A device turned by 5 degrees sees 0.09 of what V_z shows; pressure makes that ripple."""
    time = torch.linspace(0, 1, WINDOW_BINS)[None, None]
    ripple = 0.02 * torch.sin(2 * np.pi * 1.5 * time + 1.0).expand(len(windows.volts), 1, -1)
    turned = replace(windows, volts=windows.volts + 0.06 * ripple)
    truth = windows.targets[:, :5]

    def turn_deg(batch, vertical) -> float:
        heading, *_ = refine(bump_map(), batch, truth, vertical=vertical, cross_axis_sd=0.04)
        return np.degrees(np.arccos(np.clip((heading * truth[:, :2]).sum(1).numpy(), -1, 1))).mean()

    clean = turn_deg(windows, 0 * ripple)
    assert turn_deg(turned, 0 * ripple) > 1.3 * clean
    assert turn_deg(turned, ripple) < 1.2 * clean


def test_refinement_finds_the_line_from_a_start_next_to_it(windows):
    truth = windows.targets[:, :5]
    angle = 0.15
    cos, sin = np.cos(angle), np.sin(angle)
    turned = torch.stack([truth[:, 0] * cos - truth[:, 1] * sin, truth[:, 0] * sin + truth[:, 1] * cos], 1)
    start = torch.cat([turned, truth[:, 2:] + torch.tensor([0.1, 1.5, -2.0])], 1)
    heading, state, variance, misfit, *_ = refine(bump_map(), windows, start)
    error = np.degrees(np.arccos(np.clip((heading * truth[:, :2]).sum(1).numpy(), -1, 1)))
    assert np.median(error) < 0.7
    assert np.median(np.abs((state[:, 1] - truth[:, 2]).numpy())) < 0.01
    assert np.median(np.abs((state[:, 2] - truth[:, 3]).numpy())) < 0.15
    # The noise is the map's own: its reduced chi-square must be about one, and its covariance of the right order
    # (conformal calibration does the rest).
    assert 0.5 < np.median(misfit.numpy()) < 3.0
    ratio = np.abs((state[:, 2] - truth[:, 3]).numpy()) / variance[:, 2].sqrt().numpy()
    assert 0.3 < np.median(ratio) < 2.5


def test_a_depth_that_calibration_says_may_be_any_is_estimated_without_bias():
    """Slides 0.3 mm deeper and shallower: taken for the calibration's depth they are pulled to it, else not."""
    one = bump_map(gain_sd=0.005)
    several = bump_map(gain_sd=0.005, depth_sd_mm=0.5)
    for off in (-0.3, 0.3):
        shifted = bump_map(
            coefficients=one.coefficients
            + off * np.stack([one.depth_slope, *np.zeros((2, *one.depth_slope.shape))])
        )
        batch = WindowSource(shifted, BLOCK_S, WHOLE).draw(200, torch.Generator().manual_seed(6))
        truth = batch.targets[:, :5]
        near = truth[:, 3].abs() < 15
        start = truth[near]
        drawn = chosen(batch, near)
        depths = [np.mean(refine(response, drawn, start)[1][:, 5].numpy()) for response in (one, several)]
        assert depths[1] == pytest.approx(off, abs=0.04)
        assert abs(depths[0]) < abs(depths[1])


def test_refinement_sees_time_only_as_a_scale():
    quiet = bump_map(noise_v=np.full(2, 1e-9))
    batch = WindowSource(quiet, BLOCK_S, WHOLE).draw(64, torch.Generator().manual_seed(4))
    start = batch.targets[:, :5] + torch.tensor([0.0, 0.0, 0.05, 0.5, 0.5])
    slower = replace(batch, elapsed_s=4 * batch.elapsed_s)
    later = start - torch.tensor([0.0, 0.0, float(np.log(4)), 0.0, 0.0])
    heading, state, *_ = refine(quiet, batch, start)
    heading4, state4, *_ = refine(quiet, slower, later)
    np.testing.assert_allclose(heading4.numpy(), heading.numpy(), atol=2e-3)
    np.testing.assert_allclose(state4[:, 1].numpy() + np.log(4), state[:, 1].numpy(), atol=2e-3)


def test_a_signal_of_something_else_leaves_a_large_misfit(windows):
    generator = torch.Generator().manual_seed(5)
    steps = 0.1 * torch.randn(50, 2, 8, generator=generator).repeat_interleave(8, 2)
    other = replace(chosen(windows, slice(50)), volts=steps)
    _, _, _, misfit, *_ = refine(bump_map(), other, windows.targets[:50, :5])
    assert np.quantile(misfit.numpy(), 0.05) > 50


def test_strain_is_a_standard_normal_number_for_slides_that_scatter_as_the_calibration_did():
    """And it grows with a gain beyond: the prior's own standard deviation is its unit."""
    response = bump_map(gain_sd=0.02)
    batch = WindowSource(response, BLOCK_S, WHOLE).draw(400, torch.Generator().manual_seed(8))
    start = batch.targets[:, :5]
    strain = refine(response, batch, start)[4].numpy()
    assert 0.6 < np.sqrt(np.mean(np.minimum(strain, 5.0) ** 2)) < 1.4
    assert np.mean(strain > 5.0) < 0.01
    for scale in (0.5, 1.4):
        beyond = refine(response, replace(batch, volts=scale * batch.volts), start)[4].numpy()
        assert np.mean(beyond > 5.0) > 0.5


def test_intervals_that_grow_with_the_strain_hold_for_a_response_that_is_a_fifth_stronger():
    """They hold as often as for slides of the calibration's kind; others do not."""
    response = bump_map(gain_sd=0.02)
    batch = WindowSource(response, BLOCK_S, WHOLE).draw(1200, torch.Generator().manual_seed(9))
    held = {}
    for scale in (1.0, 1.2):
        scaled = replace(batch, volts=scale * batch.volts)
        _, state, variance, _, strain, _ = refine(response, scaled, batch.targets[:, :5])
        error, sd = (state[:, 2] - batch.targets[:, 3]).abs().numpy(), variance[:, 2].sqrt().numpy()
        wider = np.maximum(strain[:, 0].numpy(), 1.0)
        if scale == 1.0:
            slide = np.arange(len(error))
            fitted = {
                by: conformal_interval(error / np.where(by, wider, 1.0), sd, slide) for by in (True, False)
            }
        for grows, interval in fitted.items():
            half = [interval.half_width(*one) for one in zip(sd, strain[:, 0].numpy() * grows, strict=True)]
            held[scale, grows] = float(np.mean(error <= half))
    assert held[1.0, True] == pytest.approx(0.9, abs=0.01)
    assert held[1.2, False] < 0.85
    assert held[1.2, True] > 0.9

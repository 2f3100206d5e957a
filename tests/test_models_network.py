"""Laws of the localizing network: fixed points, convergence, scale of time, and its export."""

import numpy as np
import onnxruntime as ort
import pytest
import torch
from bump_map import bump_map

from models.cnn import initial_proposal
from models.export import export_graph
from models.network import NetworkConfig, Proposal, Refinement, SlideNetwork, solve, splines
from models.response_map import spline_basis
from models.synthetic_windows import SynthesisConfig, WindowSource
from models.training import TrainingConfig, likelihood_loss, train_proposal

BLOCK_S = 0.02
WHOLE = SynthesisConfig(complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0)


@pytest.fixture(scope="module")
def windows():
    return WindowSource(bump_map(), BLOCK_S, WHOLE).draw(400, torch.Generator().manual_seed(3))


def refine(response, batch, start, steps=8, sd=0.5):
    refinement = Refinement(response, BLOCK_S, NetworkConfig(steps=steps, trust=1.0))
    with torch.no_grad():
        return refinement(
            batch.volts, batch.elapsed_s, batch.weight, start, torch.full((len(start), 4), float(np.log(sd)))
        )


def test_splines_of_the_graph_are_those_of_the_map():
    position = np.linspace(-29, 29, 37)
    centres = -30.0 + 2.5 * (np.arange(27) - 1)
    value, slope = splines(torch.tensor((position[:, None] - centres) / 2.5))
    np.testing.assert_allclose(value.numpy(), spline_basis(position, 30.0), atol=1e-12)
    step = 1e-6
    numeric = (spline_basis(position + step, 30.0) - spline_basis(position - step, 30.0)) / (2 * step)
    np.testing.assert_allclose(slope.numpy() / 2.5, numeric, atol=1e-8)


def test_solve_inverts():
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(5, 6, 9, generator=generator, dtype=torch.float64)
    normal = root @ root.transpose(1, 2)
    right = torch.randn(5, 6, generator=generator, dtype=torch.float64)
    x, inverse = solve(normal, right, torch.zeros(5, 1))
    np.testing.assert_allclose((normal @ x.double()[:, :, None])[:, :, 0], right, atol=1e-4)
    np.testing.assert_allclose(inverse.double() @ normal, torch.eye(6).expand(5, 6, 6), atol=1e-4)


def test_refinement_finds_the_line_from_a_start_beside_it(windows):
    truth = windows.targets[:, :5]
    angle = 0.15
    cos, sin = np.cos(angle), np.sin(angle)
    turned = torch.stack([truth[:, 0] * cos - truth[:, 1] * sin, truth[:, 0] * sin + truth[:, 1] * cos], 1)
    start = torch.cat([turned, truth[:, 2:] + torch.tensor([0.1, 1.5, -2.0])], 1)
    heading, state, covariance, misfit = refine(bump_map(), windows, start)
    error = np.degrees(np.arccos(np.clip((heading * truth[:, :2]).sum(1).numpy(), -1, 1)))
    assert np.median(error) < 0.7
    assert np.median(np.abs((state[:, 2] - truth[:, 2]).numpy())) < 0.01
    assert np.median(np.abs((state[:, 1] - truth[:, 3]).numpy())) < 0.15
    # The noise is the map's own: its reduced chi-square must be about one, and its covariance of the right order
    # (conformal calibration does the rest).
    assert 0.5 < np.median(misfit.numpy()) < 3.0
    ratio = np.abs((state[:, 1] - truth[:, 3]).numpy()) / covariance[:, 1, 1].sqrt().numpy()
    assert 0.3 < np.median(ratio) < 2.5


def test_refinement_sees_time_only_as_a_scale():
    quiet = bump_map(noise_v=np.full(2, 1e-9))
    batch = WindowSource(quiet, BLOCK_S, WHOLE).draw(64, torch.Generator().manual_seed(4))
    start = batch.targets[:, :5] + torch.tensor([0.0, 0.0, 0.05, 0.5, 0.5])
    slower = type(batch)(batch.volts, 4 * batch.elapsed_s, batch.weight, batch.targets)
    later = start - torch.tensor([0.0, 0.0, float(np.log(4)), 0.0, 0.0])
    heading, state, _, _ = refine(quiet, batch, start)
    heading4, state4, _, _ = refine(quiet, slower, later)
    np.testing.assert_allclose(heading4.numpy(), heading.numpy(), atol=2e-3)
    np.testing.assert_allclose(state4[:, 2].numpy() + np.log(4), state[:, 2].numpy(), atol=2e-3)


def test_a_signal_of_something_else_leaves_a_large_misfit(windows):
    generator = torch.Generator().manual_seed(5)
    steps = 0.1 * torch.randn(50, 2, 8, generator=generator).repeat_interleave(8, 2)
    other = type(windows)(steps, windows.elapsed_s[:50], windows.weight[:50], windows.targets[:50])
    _, _, _, misfit = refine(bump_map(), other, windows.targets[:50, :5])
    assert np.quantile(misfit.numpy(), 0.05) > 50


@pytest.fixture(scope="module")
def trained():
    source = WindowSource(bump_map(), BLOCK_S, SynthesisConfig())
    return train_proposal(source, NetworkConfig(steps=2), TrainingConfig(steps=60, batch=64, seed=7))


def test_training_is_seeded_and_lowers_the_loss(trained):
    source = WindowSource(bump_map(), BLOCK_S, SynthesisConfig())
    again = train_proposal(source, NetworkConfig(steps=2), TrainingConfig(steps=60, batch=64, seed=7))
    for a, b in zip(trained.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    batch = source.draw(256, torch.Generator().manual_seed(9))
    torch.manual_seed(7)
    fresh = Proposal(2, NetworkConfig())
    with torch.no_grad():
        before, after = (
            likelihood_loss(*net(batch.volts, batch.elapsed_s, batch.weight), batch.targets)
            for net in (fresh, trained)
        )
    assert after < before - 0.5


def test_export_agrees_and_can_be_gone_on_from(trained, windows):
    config = NetworkConfig(steps=2)
    network = SlideNetwork(trained, Refinement(bump_map(), BLOCK_S, config)).eval()
    graph = export_graph(network, 1)
    session = ort.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    volts = torch.cat([windows.volts, torch.zeros_like(windows.volts[:, :1])], 1)
    inputs = {"volts": volts, "elapsed_s": windows.elapsed_s, "weight": windows.weight[:, :1]}
    (row,) = session.run(None, {k: v.numpy() for k, v in inputs.items()})
    with torch.no_grad():
        expected = network(**inputs).numpy()
    assert row.shape == (len(volts), len(network.outputs))
    assert np.quantile(np.abs(row - expected) / np.abs(expected).max(axis=0), 0.99) < 1e-4
    again = initial_proposal(graph, 2, config)
    for a, b in zip(trained.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(ValueError, match="another shape"):
        initial_proposal(graph, 4, config)
    assert sum(p.numel() for p in trained.parameters()) < 60_000

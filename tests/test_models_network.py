"""The localizing network: its training, and its export."""

import numpy as np
import onnxruntime as ort
import pytest
import torch
from bump_map import bump_map
from onnx.reference import ReferenceEvaluator

from softslide.features.errors import InputError
from softslide.features.window import WINDOW_BINS
from softslide.models.cnn.fit import initial_proposal
from softslide.models.cnn.gauss_newton import Refinement, RefinementConfig
from softslide.models.cnn.network import NetworkConfig, Proposal, SlideNetwork
from softslide.models.cnn.training import TrainingConfig, likelihood_loss, train_proposal
from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.models.graph.from_torch import export_graph
from softslide.models.graph.packing import unpack

BLOCK_S = 0.02
WHOLE = SynthesisConfig(complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0)


@pytest.fixture(scope="module")
def windows():
    return WindowSource(bump_map(), BLOCK_S, WHOLE).draw(400, torch.Generator().manual_seed(3))


def training() -> Proposal:
    source = WindowSource(bump_map(), BLOCK_S, SynthesisConfig())
    config = TrainingConfig(steps=60, batch=64, seed=7)
    return train_proposal(source, NetworkConfig(refinement=RefinementConfig(steps=2)), config)


@pytest.fixture(scope="module")
def trained():
    return training()


@pytest.fixture(scope="module")
def network(trained):
    return SlideNetwork(trained, Refinement(bump_map(), BLOCK_S, NetworkConfig().refinement)).eval()


@pytest.fixture(scope="module")
def graph(network):
    return export_graph(network, 1)


@pytest.fixture(scope="module")
def session(graph):
    return ort.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])


def test_training_is_seeded_and_lowers_the_loss(trained):
    again = training()
    for a, b in zip(trained.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    source = WindowSource(bump_map(), BLOCK_S, SynthesisConfig())
    batch = source.draw(256, torch.Generator().manual_seed(9))
    torch.manual_seed(7)
    fresh = Proposal(2, 1, NetworkConfig())
    with torch.no_grad():
        before, after = (
            likelihood_loss(*net(batch.volts, batch.elapsed_s, batch.weight), batch.targets)
            for net in (fresh, trained)
        )
    assert after < before - 0.5


def test_export_agrees_and_can_be_gone_on_from(network, graph, session, windows, trained):
    volts = torch.cat([windows.volts, torch.zeros_like(windows.volts[:, :1])], 1)
    inputs = {"volts": volts, "elapsed_s": windows.elapsed_s, "weight": windows.weight}
    (row,) = session.run(None, {k: v.numpy() for k, v in inputs.items()})
    with torch.no_grad():
        expected = network(**inputs).numpy()
    assert row.shape == (len(volts), len(network.outputs))
    # After sixty steps of training some proposals do not converge; `write_bundle` requires this of every valid window.
    assert np.quantile(np.abs(row - expected) / np.abs(expected).max(axis=0), 0.99) < 1e-4
    # Standard operators alone, so that any runtime takes the graph: ONNX's own reference gives the same.
    assert {node.domain for node in graph.graph.node} == {""}
    few = {k: v[:20].numpy() for k, v in inputs.items()}
    (reference,) = ReferenceEvaluator(graph).run(None, few)
    near = np.abs(reference - expected[:20]) / np.abs(expected).max(axis=0)
    assert np.quantile(near, 0.9) < 1e-4
    unpack(graph)
    config = NetworkConfig()
    again = initial_proposal(graph, bump_map(), config)
    for a, b in zip(trained.state_dict().values(), again.state_dict().values(), strict=True):
        assert torch.equal(a, b)
    with pytest.raises(InputError, match="another shape"):
        initial_proposal(graph, bump_map(((-9.0, 0.0), (9.0, 0.0))), config)
    assert sum(p.numel() for p in trained.parameters()) < 60_000


@pytest.mark.parametrize("volts", [0.0, 1e-30, 1e3, 1e30, np.inf, np.nan])
@pytest.mark.parametrize("elapsed_s", [0.0, 1e-30, 3.0, 1e30])
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_no_window_is_too_much_for_the_graph(session, volts, elapsed_s, weight):
    """It answers whatever it is given, and in numbers what has any length and is no more than volts can be."""
    shape = np.random.default_rng(0).normal(size=(1, 3, WINDOW_BINS))
    with np.errstate(all="ignore"):
        inputs = {"volts": volts * shape, "elapsed_s": [elapsed_s], "weight": [[weight]]}
        (row,) = session.run(None, {k: np.asarray(v, np.float32) for k, v in inputs.items()})[0]
    if volts <= 1e3 and elapsed_s > 0:
        assert np.isfinite(row).all()


@pytest.mark.long
def test_four_accelerometers_learn_as_readily_as_one():
    places = tuple((x, y) for x in (-10.0, 10.0) for y in (-10.0, 10.0))
    response = bump_map(places)
    source = WindowSource(response, BLOCK_S, SynthesisConfig())
    proposal = train_proposal(source, NetworkConfig(), TrainingConfig(steps=300, batch=128, average=0.98))
    batch = WindowSource(response, BLOCK_S, WHOLE).draw(400, torch.Generator().manual_seed(3))
    with torch.no_grad():
        direction = torch.nn.functional.normalize(
            proposal(batch.volts, batch.elapsed_s, batch.weight)[0][:, :2]
        )
    error = torch.rad2deg(torch.acos((direction * batch.targets[:, :2]).sum(1).clamp(-1, 1)))
    # A network that learns nothing is 90 deg off.
    assert error.median() < 20

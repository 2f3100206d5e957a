"""A bundle for a magnetometer: its graph, its stream, its C code, and what does not apply to it."""

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from c_case import NEEDS_COMPILER, Case, compiled, difference
from dome_map import dome_map
from touched_bundle import at_rest, circle, on_the_circle, outputs
from touched_skin import NOISE, RATE_HZ, SENSOR, UNIT, recorded, write_skin

from softslide.features.angles import wrapped_deg
from softslide.features.card import Interval, Validity, read_card
from softslide.features.stream.conditioning import Conditioning
from softslide.features.stream.tracker import SlideState
from softslide.models.cnn.gauss_newton import Refinement, RefinementConfig
from softslide.models.cnn.network import NetworkConfig, SlideNetwork
from softslide.models.cnn.training import TrainingConfig, train_proposal
from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource
from softslide.models.export.bundle import PARITY, graph_inputs, read_graph, write_bundle
from softslide.models.export.formats import export
from softslide.models.fitted_model import FittedModel
from softslide.models.graph.from_torch import export_graph
from softslide.models.held_out import believed
from softslide.models.response_map.card import contact_calibration
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import LabelledWindows, labelled_windows
from softslide.serve.localizer import Localizer

pytestmark = pytest.mark.long
STEPS = 10  # of Gauss-Newton


@pytest.fixture(scope="module")
def skin(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    return write_skin(tmp_path_factory.mktemp("skin") / "folder", 12, 4)


@pytest.fixture(scope="module")
def windows(skin: Folder) -> LabelledWindows:
    return labelled_windows(skin, conditioning_for(skin, Conditioning()))


@pytest.fixture(scope="module")
def bundle(skin: Folder, windows: LabelledWindows, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The formula's map with a network that was trained on it for seconds; exported, or refused, as `train` does."""
    torch.set_num_threads(1)
    conditioning = conditioning_for(skin, Conditioning())
    assert (conditioning.touch_axes, conditioning.onset) == ("xyz", "touch")
    block_v = NOISE * conditioning.scale / np.sqrt(conditioning.block_samples(RATE_HZ))
    coefficients = UNIT * conditioning.scale * dome_map().coefficients
    noise = {
        "noise_v": np.full(3, block_v),
        "zero_v": np.full(3, block_v / 2),
        "drift_v_s": np.zeros(3),
        "floor_v": block_v,
    }
    response = replace(dome_map(), coefficients=coefficients, **noise)
    config = NetworkConfig(refinement=RefinementConfig(steps=STEPS))
    source = WindowSource(response, conditioning.block_s, SynthesisConfig(speed_mm_s=(10.0, 60.0)))
    proposal = train_proposal(source, config, TrainingConfig(steps=150, batch=64, rate=0.01, average=0.9))
    network = SlideNetwork(proposal, Refinement(response, conditioning.block_s, config.refinement)).eval()

    def original(inputs: dict[str, np.ndarray]) -> np.ndarray:
        with torch.no_grad():
            return network(**{k: torch.tensor(v, dtype=torch.float32) for k, v in inputs.items()}).numpy()

    fitted = FittedModel(
        name="cnn",
        input="window",
        outputs=network.outputs,
        graph=export_graph(network, 1),
        original=original,
        intervals={name: Interval(2.0, 0.0) for name in ("direction_deg", "log_speed", "offset_mm")},
        validity=Validity(misfit=5.0, direction_sd_deg=6.0, log_speed_sd=0.1),
        conditioning=conditioning,
        summary={},
        contact=contact_calibration(response),
    )
    out = tmp_path_factory.mktemp("bundle") / "m"
    write_bundle(fitted, SENSOR, windows, {}, out)
    return out


def test_a_stream_ends_in_the_slide_that_was_recorded(bundle: Path) -> None:
    for seed, line in enumerate([(33.0, 4.0, 25.0), (140.0, -6.0, 18.0), (290.0, 2.0, 35.0)]):
        volts, _ = recorded(*line, seed=100 + seed)
        localizer = Localizer.load(bundle)
        whole = localizer.push(volts)
        last = whole[-1]
        assert last.valid
        assert abs(wrapped_deg(last.direction_deg - line[0])) < 1.5
        assert last.offset_mm == pytest.approx(line[1], abs=0.3)
        assert last.speed_mm_s == pytest.approx(line[2], rel=0.03)
        # In what chunks the samples come makes no difference; drift by gravity has no meaning here.
        localizer.reset()
        pieces = [e for n in range(0, len(volts), 7) for e in localizer.push(volts[n : n + 7])]
        assert [repr(e) for e in pieces] == [repr(e) for e in whole]
        assert np.isnan([last.gain, last.turn_deg]).all()


def test_a_circle_is_followed_and_is_not_a_slide(bundle: Path) -> None:
    estimates = Localizer.load(bundle).push(outputs(at_rest(1.0), circle(), at_rest(1.0)))
    long_s = len(circle()) / RATE_HZ
    live = [e for e in estimates if e.valid and e.state is SlideState.SLIDE and e.time_s < 1 + long_s]
    assert len(live) > 0.4 * long_s / 0.02
    x, y, vx, vy = on_the_circle(np.array([e.time_s for e in live]) - 1.0).T
    assert np.median(np.hypot([e.x_mm for e in live] - x, [e.y_mm for e in live] - y)) < 0.5
    turned = wrapped_deg(np.array([e.direction_deg for e in live]) - np.degrees(np.arctan2(vy, vx)))
    assert np.median(np.abs(turned)) < 6.0
    # The whole of it passes for no straight slide.
    assert not estimates[-1].valid


@NEEDS_COMPILER
def test_its_c_code_computes_the_same(bundle: Path, windows: LabelledWindows, tmp_path: Path) -> None:
    report = export(bundle, "c", tmp_path / "c")
    compiled(tmp_path / "c", "check")
    assert subprocess.run([tmp_path / "c" / "check"], check=False, timeout=60).returncode == 0
    assert report["single_differs"] < PARITY or report["precision"] == "as trained"
    card = read_card(bundle / "model.json")
    some = windows[np.arange(0, len(windows), 5)]
    case = Case(read_graph(bundle), graph_inputs("window", some.volts, some.elapsed_s))
    wanted = case.onnx_rows()
    stands = believed(wanted, card.outputs, card.validity)
    assert stands.sum() > 10
    assert difference(case.c_rows(tmp_path, card)[stands], wanted[stands]) < PARITY

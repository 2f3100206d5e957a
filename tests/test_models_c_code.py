"""The generated C computes what ONNX Runtime does, for every model, and keeps to its memory."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from bump_map import bump_map
from c_case import NEEDS_COMPILER, SANITIZED, Case, any_card, compiled, difference
from feature_models import small_model
from front_door import refused
from slide_windows import labelled_slides
from small_bundle import resigned, write_small_bundle
from streams import a_sensor

import softslide
from softslide.features.card import Card
from softslide.models.classical import interpolation
from softslide.models.classical.fit import graph_of
from softslide.models.classical.regression import float_features
from softslide.models.cnn.gauss_newton import Refinement
from softslide.models.cnn.network import OUTPUTS, NetworkConfig, SlideNetwork
from softslide.models.cnn.training import TrainingConfig, train_proposal
from softslide.models.cnn.training_windows import SynthesisConfig, WindowBatch, WindowSource
from softslide.models.export.bundle import PARITY
from softslide.models.export.c_code import sources
from softslide.models.export.formats import export, in_single
from softslide.models.graph.from_torch import export_graph

pytestmark = NEEDS_COMPILER


# A Gaussian process's place along the line is a sum of far larger weights; `export` leaves such a graph in double.
LESS_DIGITS = {"gp": 5e-3}


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Card:
    return any_card(tmp_path_factory.mktemp("bundle"))


def a_model(name: str) -> Case:
    """A model on windows, its graph as `train` exports it."""
    if name == "cnn":
        return a_network()
    offsets = np.array([-12.0, -9.0, -6.0, -3.0, 3.0, 6.0, 9.0, 12.0])
    slides = labelled_slides(interpolation.DIRECTIONS_DEG, offsets)
    features = float_features(slides)
    noise = np.random.default_rng(0).normal(0, 0.1, features.shape).astype(np.float32)
    graph = graph_of(small_model(name, slides), features.shape[1])
    return Case(graph, {"features": np.concatenate([features, features + noise])})


class FewSlides(WindowSource):
    """Sixteen slides, with other noise each time: what a network learns in seconds well enough to stand behind."""

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        slides = super().draw(16, torch.Generator().manual_seed(1))
        volts, *others = (
            v.repeat_interleave(count // len(slides.volts), 0)
            for v in (slides.volts, slides.elapsed_s, slides.weight, slides.targets, slides.seen)
        )
        return WindowBatch(volts + 5e-4 * torch.randn(volts.shape, generator=generator), *others)


def a_network() -> Case:
    """On windows that tell the speed to 5 %: those that tell less hand on more of the rounding, and where an estimate
    is not valid it decides between two minima."""
    torch.set_num_threads(1)
    config = NetworkConfig()
    whole = SynthesisConfig(complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0)
    source = FewSlides(bump_map(), 0.02, whole)
    training = TrainingConfig(steps=300, batch=64, rate=0.01, average=0.9, seed=7)
    network = SlideNetwork(
        train_proposal(source, config, training), Refinement(bump_map(), 0.02, config.refinement)
    ).eval()
    drawn = source.draw(160, torch.Generator().manual_seed(3))
    volts = torch.cat([drawn.volts, torch.zeros_like(drawn.volts[:, :1])], 1)
    inputs = {"volts": volts, "elapsed_s": drawn.elapsed_s, "weight": drawn.weight}
    with torch.no_grad():
        column = dict(zip(OUTPUTS, network(**inputs).T, strict=False))
    stands = (column["misfit"] < 5) & (column["direction_sd_deg"] < 8) & (column["log_speed_sd"] < 0.05)
    assert stands.sum() >= 50
    return Case(export_graph(network, 1), {k: v[stands].numpy() for k, v in inputs.items()})


@pytest.fixture(
    scope="module",
    params=["interpolation", "trees", "mlp", "gp", pytest.param("cnn", marks=pytest.mark.long)],
)
def model(request: pytest.FixtureRequest) -> Case:
    return a_model(request.param)


def test_a_model_computes_the_same(model: Case, card: Card, tmp_path: Path) -> None:
    assert difference(model.c_rows(tmp_path, card), model.onnx_rows()) < 1e-5


def test_in_single_precision_a_model_computes_the_same(
    model: Case, card: Card, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """On slides, where it is believed; the C code then holds no double at all."""
    slides = {name: rows[: len(rows) // 2] for name, rows in model.inputs.items()}
    single, whole = Case(in_single(model.graph), slides), Case(model.graph, slides)
    limit = LESS_DIGITS.get(request.node.callspec.params["model"], PARITY)
    assert difference(single.c_rows(tmp_path, card), whole.onnx_rows()) < limit
    assert not re.search(r"\bdouble (tmp|work|weight)", (tmp_path / "model.c").read_text())


def test_a_graph_that_loses_its_digits_stays_as_it_was_trained(tmp_path: Path) -> None:
    """x + 1e9 - 1e9: in single precision nothing of x is left."""
    bundle = write_small_bundle(tmp_path / "b", a_sensor(), offset_mm_per_v=50.0)
    graph = onnx.load_model_from_string((bundle / "model.onnx").read_bytes())
    name = graph.graph.node[-1].output[0]
    graph.graph.node[-1].output[0] = "row"
    make = onnx.helper.make_node
    graph.graph.initializer.append(onnx.numpy_helper.from_array(np.array([1e9]), "large"))
    graph.graph.node.extend(
        [
            make("Cast", ["row"], ["wide"], to=onnx.TensorProto.DOUBLE),
            make("Add", ["wide", "large"], ["sum"]),
            make("Sub", ["sum", "large"], ["rest"]),
            make("Cast", ["rest"], [name], to=onnx.TensorProto.FLOAT),
        ]
    )
    (bundle / "model.onnx").write_bytes(graph.SerializeToString())
    resigned(bundle)
    report = export(bundle, "c", tmp_path / "c")
    assert report["precision"] == "as trained"
    assert report["single_differs"] > PARITY
    assert "static double work_double" in (tmp_path / "c" / "model.c").read_text()


def test_a_model_keeps_to_its_memory(model: Case, card: Card, tmp_path: Path) -> None:
    """Under the address and undefined-behaviour sanitizers, which end the process at the first fault."""
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    if subprocess.run(["cc", *SANITIZED, probe, "-o", tmp_path / "probe"], capture_output=True).returncode:
        pytest.skip("this compiler has no sanitizers")
    assert difference(model.c_rows(tmp_path, card, SANITIZED), model.onnx_rows()) < 1e-5


def test_export_writes_c_that_works_its_own_example(
    two_boards: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    bundle, out = two_boards, tmp_path / "c"
    assert softslide.main(["export", "--model", str(bundle), "--to", "c", "--out", str(out)]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["operators"]["Gemm"] == 1
    assert report["constants_kb"] == pytest.approx((6 * 64 * 5 + 5) * 4 / 1e3)
    assert report["static_ram_kb"] <= 384 * 4 / 1e3
    assert (out / "model.json").read_bytes() == (bundle / "model.json").read_bytes()
    assert "const float volts[384], float elapsed_s, const float weight[2]" in (out / "model.h").read_text()
    compiled(out, "check")
    assert subprocess.run([out / "check"], capture_output=True, check=False).returncode == 0
    text = (out / "model.c").read_text()
    (out / "model.c").write_text(text[: text.rindex("}")] + "    estimate[0] += 1;\n}\n")
    compiled(out, "check")
    assert subprocess.run([out / "check"], capture_output=True, check=False).returncode != 0


def test_what_has_no_form_in_c_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor())
    graph = onnx.load_model_from_string((bundle / "model.onnx").read_bytes())
    graph.graph.node[1].output[0] = "row"
    more = {"domain": "ai.onnx.ml", "coefficients": np.eye(5).ravel().tolist(), "targets": 5}
    graph.graph.node.append(onnx.helper.make_node("LinearRegressor", ["row"], ["estimate"], **more))
    graph.opset_import.append(onnx.helper.make_opsetid("ai.onnx.ml", 3))
    (bundle / "model.onnx").write_bytes(graph.SerializeToString())
    resigned(bundle)
    words = ("export", "--model", bundle, "--to", "c", "--out", tmp_path / "c")
    assert "LinearRegressor" in refused(capsys, *words)
    assert not (tmp_path / "c").exists()


EVIL = "x */ int evil_was_here = 1; /* "


def with_evil_texts(graph: onnx.ModelProto) -> onnx.ModelProto:
    """The graph with this text wherever one is the author's choice."""
    kept = {value.name for value in (*graph.graph.input, *graph.graph.output)}
    graph.producer_name = graph.producer_version = graph.domain = graph.doc_string = EVIL
    graph.graph.name = graph.graph.doc_string = EVIL
    graph.metadata_props.add(key=EVIL, value=EVIL)
    for n, node in enumerate(graph.graph.node):
        node.name, node.doc_string = f"{EVIL}{n}", EVIL
        for names in (node.input, node.output):
            names[:] = [name if name in kept else EVIL + name for name in names]
        for attribute in node.attribute:
            attribute.doc_string = EVIL
    for item in graph.graph.initializer:
        item.name, item.doc_string = EVIL + item.name, EVIL
    for value in (*graph.graph.input, *graph.graph.output):
        value.doc_string = EVIL
        value.type.tensor_type.shape.dim[0].dim_param = EVIL
    return graph


def test_no_text_of_a_graph_gets_into_the_code(tmp_path: Path) -> None:
    bundle, out = write_small_bundle(tmp_path / "b", a_sensor()), tmp_path / "c"
    graph = with_evil_texts(onnx.load_model_from_string((bundle / "model.onnx").read_bytes()))
    (bundle / "model.onnx").write_bytes(graph.SerializeToString())
    resigned(bundle)
    export(bundle, "c", out)
    for path in out.glob("*.[ch]"):
        assert "evil" not in path.read_text()
    compiled(out, "check")
    assert subprocess.run([out / "check"], capture_output=True, check=False).returncode == 0


def test_an_attribute_with_such_a_text_is_refused(tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor())
    graph = onnx.load_model_from_string((bundle / "model.onnx").read_bytes())
    graph.graph.node[0].attribute.append(onnx.helper.make_attribute("mode", EVIL))
    with pytest.raises(ValueError, match="Flatten with the text"):
        sources(graph, any_card(tmp_path / "card"))

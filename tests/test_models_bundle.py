"""A bundle is written only if its graph computes what was trained; its ORT format and its page for a hub."""

import json
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from onnx import TensorProto, helper
from slide_windows import labelled_slides
from streams import a_sensor, pass_over, still, stream

import softslide
from softslide.features.card import Interval, Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.features.window import WINDOW_BINS
from softslide.models.export.bundle import ParityError, write_bundle
from softslide.models.fitted_model import FittedModel
from softslide.serve.localizer import Localizer

WINDOWS = labelled_slides(np.arange(0.0, 360.0, 15.0), np.linspace(-12.0, 12.0, 10))
OUTPUTS = ("direction_cos", "direction_sin", "offset_mm")


def a_model(wrong: np.ndarray) -> FittedModel:
    """The windows' mean volts as an estimate; the original is off by `wrong` (n,) volts."""
    mean = helper.make_node("ReduceMean", ["volts", "axes"], ["estimate"], keepdims=0)
    shapes = {"volts": ["b", 3, WINDOW_BINS], "elapsed_s": ["b"], "weight": ["b", 1]}
    graph = helper.make_graph(
        [mean],
        "mean",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()],
        [helper.make_tensor_value_info("estimate", TensorProto.FLOAT, ["b", 3])],
        [helper.make_tensor("axes", TensorProto.INT64, [1], [2])],
    )
    return FittedModel(
        name="mean",
        input="window",
        outputs=OUTPUTS,
        graph=helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10),
        original=lambda inputs: inputs["volts"].mean(axis=2) + wrong[:, None],
        intervals={"offset_mm": Interval(1.0, 1.0)},
        validity=Validity(),
        conditioning=Conditioning(),
    )


def written(wrong: np.ndarray, out: Path) -> float:
    return write_bundle(a_model(wrong), a_sensor(), WINDOWS, {}, out)


def test_a_graph_that_agrees_is_written(tmp_path: Path) -> None:
    assert written(np.zeros(len(WINDOWS)), tmp_path / "bundle") < 1e-5
    assert (tmp_path / "bundle" / "model.onnx").is_file()


@pytest.mark.parametrize("windows", [1, len(WINDOWS)])
def test_a_graph_that_computes_something_else_is_refused(tmp_path: Path, windows: int) -> None:
    wrong = np.where(np.arange(len(WINDOWS)) < windows, 3e-5, 0.0)
    with pytest.raises(ParityError, match="differ by"):
        written(wrong, tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()


@pytest.mark.parametrize(("output", "alike"), [("depth_sd_mm", True), ("depth_mm", False)])
def test_rounding_may_move_a_deviation_further_than_an_estimate(
    tmp_path: Path, output: str, alike: bool
) -> None:
    """By 5e-4 of the largest."""
    largest = np.abs(WINDOWS.volts.mean(axis=2)).max(axis=0)
    plain = a_model(np.zeros(len(WINDOWS)))
    model = replace(
        plain,
        outputs=(output, *OUTPUTS[1:]),
        original=lambda inputs: plain.original(inputs) + 5e-4 * largest * [1, 0, 0],
    )
    with nullcontext() if alike else pytest.raises(ParityError, match=f"in {output} .limit 0.0001"):
        write_bundle(model, a_sensor(), WINDOWS, {}, tmp_path / "bundle")
    assert (tmp_path / "bundle").exists() is alike


VOLTS = stream(still(0.6), pass_over(1.2), still(0.4))


def offsets(bundle: Path) -> np.ndarray:
    return np.array([estimate.offset_mm for estimate in Localizer.load(bundle).push(VOLTS)])


def export(bundle: Path, shape: str, out: Path) -> int:
    return softslide.main(["export", "--model", str(bundle), "--to", shape, "--out", str(out)])


def test_ort_gives_the_same_numbers(bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert export(bundle, "ort", tmp_path / "out") == 0
    found = json.loads(capsys.readouterr().out)
    written = {"model.json", "model.ort", "required_operators.config"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == written
    assert any("Gemm" in line for line in found["operators"])
    assert offsets(tmp_path / "out") == pytest.approx(offsets(bundle), abs=1e-5, nan_ok=True)


def test_the_page_for_a_hub_reads_and_its_code_runs(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert export(bundle, "hub", tmp_path / "out") == 0
    _, head, body = (tmp_path / "out" / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(head)["library_name"] == "softslide"
    assert "accelerometer at (" in body
    monkeypatch.chdir(tmp_path / "out")
    printed: list[tuple] = []
    code = body.split("```python\n")[1].split("```")[0]
    exec(code, {"volts": VOLTS, "print": lambda *values: printed.append(values)})
    assert len(printed) == len(VOLTS) // 20
    assert any(valid for valid, *_ in printed)

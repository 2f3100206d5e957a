"""A bundle is written only if its graph computes what was trained."""

from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto, helper
from slide_windows import labelled_slides
from streams import a_sensor

from softslide.features.card import Interval, Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.features.window import WINDOW_BINS
from softslide.models.export.bundle import ParityError, write_bundle
from softslide.models.fitted_model import FittedModel
from softslide.pipeline.sensor import Sensor

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
    sensor = a_sensor()
    assert isinstance(sensor, Sensor)
    return write_bundle(a_model(wrong), sensor, WINDOWS, {}, out)


def test_a_graph_that_agrees_is_written(tmp_path: Path) -> None:
    assert written(np.zeros(len(WINDOWS)), tmp_path / "bundle") < 1e-5
    assert (tmp_path / "bundle" / "model.onnx").is_file()


@pytest.mark.parametrize("windows", [1, len(WINDOWS)])
def test_a_graph_that_computes_something_else_is_refused(tmp_path: Path, windows: int) -> None:
    wrong = np.where(np.arange(len(WINDOWS)) < windows, 3e-5, 0.0)
    with pytest.raises(ParityError, match="differ by"):
        written(wrong, tmp_path / "bundle")
    assert not (tmp_path / "bundle").exists()

"""A bundle whose graph is one matrix product, so that its estimates can be calculated by hand."""

import hashlib
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from onnx import TensorProto, helper, numpy_helper

from softslide.features.card import Card, Interval, Validity, card_hash, write_card
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.stream.conditioning import Conditioning
from softslide.features.window import WINDOW_BINS
from softslide.pipeline.sensor import Sensor

OUTPUTS = ("direction_cos", "direction_sin", "log_speed", "offset_mm", "along_mm")


def write_small_bundle(
    folder: Path,
    sensor: Sensor,
    *,
    direction_deg: float = 30.0,
    speed_mm_s: float = 2.0,
    offset_mm: float = 5.0,
    offset_mm_per_v: float = 0.0,
    along_mm: float = 0.0,
    conditioning: Conditioning = Conditioning(),  # noqa: B008
    contact: ContactCalibration | None = None,
) -> Path:
    """Always the same direction and speed; the offset grows with the mean of the first channel's window."""
    size = len(sensor.channels) * WINDOW_BINS
    answer = {
        "direction_cos": math.cos(math.radians(direction_deg)),
        "direction_sin": math.sin(math.radians(direction_deg)),
        "log_speed": math.log(speed_mm_s),
        "offset_mm": offset_mm,
        "along_mm": along_mm,
    }
    weights = np.zeros((size, len(OUTPUTS)), np.float32)
    weights[:WINDOW_BINS, OUTPUTS.index("offset_mm")] = offset_mm_per_v / WINDOW_BINS
    bias = np.array([answer[name] for name in OUTPUTS], np.float32)
    graph = helper.make_graph(
        [
            helper.make_node("Flatten", ["volts"], ["flat"]),
            helper.make_node("Gemm", ["flat", "weights", "bias"], ["estimate"]),
        ],
        "small",
        [
            helper.make_tensor_value_info(
                "volts", TensorProto.FLOAT, ["B", len(sensor.channels), WINDOW_BINS]
            ),
            helper.make_tensor_value_info("elapsed_s", TensorProto.FLOAT, ["B"]),
            helper.make_tensor_value_info("weight", TensorProto.FLOAT, ["B", len(sensor.accelerometers)]),
        ],
        [helper.make_tensor_value_info("estimate", TensorProto.FLOAT, ["B", len(OUTPUTS)])],
        [numpy_helper.from_array(weights, "weights"), numpy_helper.from_array(bias, "bias")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    example = {
        "volts": np.linspace(-0.1, 0.1, size, dtype=np.float32).reshape(1, -1, WINDOW_BINS),
        "elapsed_s": np.ones(1, np.float32),
        "weight": np.ones((1, len(sensor.accelerometers)), np.float32),
    }
    return write_bundle_of(
        folder,
        content,
        example,
        sensor,
        model="small",
        outputs=OUTPUTS,
        conditioning=conditioning,
        contact=contact,
    )


def write_bundle_of(
    folder: Path, graph: bytes, example: dict[str, np.ndarray], sensor: Sensor, **card: Any
) -> Path:
    """A graph on windows, and its card with what it makes of an example."""
    (row,) = ort.InferenceSession(graph, providers=["CPUExecutionProvider"]).run(None, example)[0]
    folder.mkdir(parents=True)
    (folder / "model.onnx").write_bytes(graph)
    given = {
        "input": "window",
        "sensor": asdict(sensor),
        "channels": sensor.channels,
        "sample_rate_hz": sensor.sample_rate_hz,
        "reference_mm": sensor.reference_mm,
        "conditioning": Conditioning(),
        "intervals": {
            "direction_deg": Interval(1.0, 2.0),
            "log_speed": Interval(1.0, 0.1),
            "offset_mm": Interval(1.0, 1.0),
        },
        "validity": Validity(),
        "provenance": {},
        "golden": {"inputs": {k: v.tolist() for k, v in example.items()}, "estimate": row.tolist()},
        "graph_sha256": hashlib.sha256(graph).hexdigest(),
    }
    write_card(Card(**{**given, **card}), folder / "model.json")
    return folder


def resigned(bundle: Path, graph: bytes | None = None) -> None:
    """Makes the card fit a graph that was changed, or this one; of `graph` the example is not run."""
    table = json.loads((bundle / "model.json").read_text())
    if graph is None:
        graph = (bundle / "model.onnx").read_bytes()
        inputs = {k: np.array(v, np.float32) for k, v in table["golden"]["inputs"].items()}
        session = ort.InferenceSession(graph, providers=["CPUExecutionProvider"])
        table["golden"]["estimate"] = session.run(None, inputs)[0][0].tolist()
    (bundle / "model.onnx").write_bytes(graph)
    table["graph_sha256"] = hashlib.sha256(graph).hexdigest()
    write_table(bundle, table)


def write_table(bundle: Path, table: dict[str, Any]) -> None:
    """Writes a card's table with the hash that fits it."""
    (bundle / "model.json").write_text(json.dumps(table | {"card_sha256": card_hash(table)}))

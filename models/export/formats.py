"""Other shapes of a bundle: C99, the ORT format for a reduced build of ONNX Runtime, and static int8."""

import hashlib
import logging
import math
import shutil
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

from features.angles import wrapped_deg
from features.card import Card, write_card
from features.errors import InputError
from models.export.bundle import PARITY, believed, graph_inputs, read_graph, relative_differences, session_of
from models.export.c99.node import NoForm
from models.export.c99.precision import in_single
from models.export.c99.source import sources
from models.graph.packing import pack
from pipeline.recordings.folder import SAMPLE, read_folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows
from pipeline.sensor import KINDS, Sensor
from pipeline.staging import staged
from serve.bundle import open_bundle, open_session

# What int8 may add to any mean error before it is refused.
WORSE = 1.1
# Of the sample's recordings one in so many is compared: fifteen, of every split.
EVERY = 4


def export(bundle: Path, shape: str, out: Path) -> dict[str, Any]:
    """Writes the bundle in another shape, whole or not at all, and returns what there is to say about it.

    Raises:
        InputError: the bundle is not what it should be, the shape is impossible for its model, or int8 costs more
            than a tenth of its accuracy.
    """
    card, _ = open_bundle(bundle)
    path = bundle / "model.onnx"
    if not path.is_file():
        raise InputError(f"{path}: no such file; name the bundle that 'softslide train' wrote")
    return {"int8": _as_int8, "ort": _as_ort, "c": _as_c}[shape](card, path, out)


def _as_c(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """model.c and model.h, check.c that works the card's example with them, and the card as it is.

    In single precision where that gives the same rows, else in that of the graph.
    """
    graph = read_graph(path.parent)
    single = in_single(graph)
    differs = precision_difference(card, graph, single)
    try:
        files, figures = sources(single if differs <= PARITY else graph, card)
    except NoForm as error:
        raise InputError(
            f"{path}: {error} has no form in C; use the ORT format on a small processor"
        ) from None
    with staged(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")
        shutil.copyfile(path.parent / "model.json", folder / "model.json")
    figures |= {
        "precision": "single" if differs <= PARITY else "as trained",
        "single_differs": differs if math.isfinite(differs) else None,
    }
    return {"shape": "c", "source_kb": len(files["model.c"]) / 1e3, **figures}


def precision_difference(card: Card, graph: onnx.ModelProto, single: onnx.ModelProto) -> float:
    """The largest relative difference of two graphs' believed rows, on the card's example and windows of the sample."""
    inputs = {name: np.array(value, np.float32) for name, value in card.golden["inputs"].items()}
    folder = read_folder(SAMPLE)
    if _is_like(folder.sensor, card):
        some = replace(folder, manifest=folder.manifest.iloc[::EVERY])
        windows = labelled_windows(some, card.conditioning, (0.6, 0.8, 1.0))
        more = graph_inputs(card.input, windows.volts, windows.elapsed_s)
        inputs = {name: np.concatenate([value, more[name]]) for name, value in inputs.items()}
    rows, other = (_rows(content.SerializeToString(), inputs) for content in (graph, single))
    stands = believed(rows, card)
    return float(relative_differences(other[stands], rows[stands]).max()) if stands.any() else math.inf


def _rows(graph: bytes, inputs: dict[str, np.ndarray]) -> np.ndarray:
    """Rows (n, K) of a graph, one window at a time, as on a device."""
    session = session_of(graph)
    count = len(next(iter(inputs.values())))
    return np.concatenate(
        [session.run(None, {k: v[n : n + 1] for k, v in inputs.items()})[0] for n in range(count)]
    )


def _as_ort(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """model.ort, and required_operators.config for ONNX Runtime's --include_ops_by_config."""
    small = _optimized(path, "ORT")
    operators = _operators(onnx.load_model_from_string(_optimized(path, "ONNX")))
    with staged(out) as folder:
        (folder / "model.ort").write_bytes(small)
        (folder / "required_operators.config").write_text("\n".join(operators) + "\n", encoding="utf-8")
        _write_card(card, small, folder, {})
    return {"shape": "ort", "model_kb": len(small) / 1e3, "operators": operators}


def _as_int8(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """Weights per channel in S8, activations in U8, of the products with constant weights; the rest stays float32."""
    graph = read_graph(path.parent)
    names = _weighted(graph)
    if not names:
        raise InputError(f"{path}: a {card.model} graph holds no convolution or dense layer to quantize")
    windows = _sample(card, path)
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "model.onnx"
        with _quiet():
            quantize_static(
                _named(graph),
                str(target),
                _Calibration(graph_inputs(card.input, windows.volts, windows.elapsed_s)),
                quant_format=QuantFormat.QDQ,
                activation_type=QuantType.QUInt8,
                weight_type=QuantType.QInt8,
                per_channel=True,
                # Weights of 7 bits: processors without VNNI add products of 8 bits in 16, and saturate.
                reduce_range=True,
                nodes_to_quantize=names,
            )
        quantized = onnx.load_model_from_string(target.read_bytes())
        pack(quantized)
        small = quantized.SerializeToString()
    fine, coarse = (_errors(card, content, path, windows) for content in (path.read_bytes(), small))
    for quantity, error in coarse.items():
        if not error <= WORSE * fine[quantity] + 1e-3:
            raise InputError(
                f"{path}: int8 takes {quantity} from {fine[quantity]:.3g} to {error:.3g}; keep float32"
            )
    figures = {"float32": fine, "int8": coarse}
    with staged(out) as folder:
        (folder / "model.onnx").write_bytes(small)
        _write_card(card, small, folder, {"int8": figures})
    return {"shape": "int8", "model_kb": len(small) / 1e3, "errors": figures}


@contextmanager
def _quiet() -> Iterator[None]:
    """Says nothing of the preparation that the quantizer recommends, which changes nothing here, nor of an input that
    need not be given."""
    logging.disable(logging.WARNING)
    ort.set_default_logger_severity(3)
    try:
        yield
    finally:
        logging.disable(logging.NOTSET)
        ort.set_default_logger_severity(2)


class _Calibration(CalibrationDataReader):
    """One window after the other."""

    def __init__(self, inputs: dict[str, np.ndarray]) -> None:
        self._rows = iter(
            [{k: v[n : n + 1] for k, v in inputs.items()} for n in range(len(next(iter(inputs.values()))))]
        )

    def get_next(self) -> dict[str, np.ndarray] | None:
        return next(self._rows, None)


def _optimized(path: Path, form: str) -> bytes:
    """The graph with basic optimizations only: what goes beyond is chosen for the processor at hand."""
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.add_session_config_entry("session.save_model_format", form)
    options.log_severity_level = 4
    # ONNX Runtime writes to files alone, and does not say why it cannot: not where the output goes.
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "model"
        options.optimized_model_filepath = str(target)
        ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        return target.read_bytes()


def _operators(graph: onnx.ModelProto) -> list[str]:
    """Lines of domain;opset;operators, as ONNX Runtime's build reads them."""
    opsets = {opset.domain or "ai.onnx": opset.version for opset in graph.opset_import}
    found = defaultdict(set)
    for node in graph.graph.node:
        found[node.domain or "ai.onnx"].add(node.op_type)
    return [
        f"{domain};{opsets.get(domain, 1)};{','.join(sorted(kinds))}"
        for domain, kinds in sorted(found.items())
    ]


def _named(graph: onnx.ModelProto) -> onnx.ModelProto:
    for n, node in enumerate(graph.graph.node):
        node.name = f"{node.op_type}_{n}"
    return graph


def _weighted(graph: onnx.ModelProto) -> list[str]:
    """Names of the convolutions and dense layers whose weights are constants of their own."""
    constants = {item.name for item in graph.graph.initializer}
    return [
        node.name
        for node in _named(graph).graph.node
        if node.op_type in ("Conv", "Gemm") and len(node.input) > 1 and node.input[1] in constants
    ]


def _sample(card: Card, path: Path) -> LabelledWindows:
    """Windows of the recordings that ship with the project, to set ranges on and to judge by."""
    folder = read_folder(SAMPLE)
    if not _is_like(folder.sensor, card):
        kind = card.sensor["accelerometers"][0].get("kind", KINDS[0])
        raise InputError(
            f"{path}: int8 is set on the sample of one accelerometer, the bundle has {len(card.channels) // 3} "
            f"of kind '{kind}'; keep float32"
        )
    return labelled_windows(folder, card.conditioning, (0.6, 0.8, 1.0))


def _is_like(sensor: Sensor, card: Card) -> bool:
    """Whether a sensor's outputs mean what the card's do."""
    return (sensor.channels, sensor.touch_axes) == (card.channels, card.conditioning.touch_axes)


def _errors(card: Card, graph: bytes, path: Path, windows: LabelledWindows) -> dict[str, float]:
    """Mean absolute errors on the windows."""
    inputs = graph_inputs(card.input, windows.volts, windows.elapsed_s)
    rows = open_session(graph, path).run(None, inputs)[0].astype(float)
    column = dict(zip(card.outputs, rows.T, strict=True))
    direction = np.degrees(np.arctan2(column["direction_sin"], column["direction_cos"]))
    errors = {
        "direction_deg": np.abs(-wrapped_deg(windows.direction_deg - direction)),
        "offset_mm": np.abs(column["offset_mm"] - windows.offset_mm),
    }
    if "log_speed" in column:
        errors["speed_percent"] = 100 * np.abs(np.expm1(column["log_speed"] - np.log(windows.speed_mm_s)))
    return {name: float(values.mean()) for name, values in errors.items()}


def _write_card(card: Card, graph: bytes, folder: Path, more: dict[str, Any]) -> None:
    """The card with the new graph's hash and its own row for the worked example."""
    session = open_session(graph, folder)
    inputs = {k: np.array(v, dtype=np.float32) for k, v in card.golden["inputs"].items()}
    row = session.run(None, inputs)[0][0]
    changed = replace(
        card,
        golden={**card.golden, "estimate": row.tolist()},
        graph_sha256=hashlib.sha256(graph).hexdigest(),
        provenance={**card.provenance, **more},
    )
    write_card(changed, folder / "model.json")

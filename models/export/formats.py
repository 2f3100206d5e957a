"""Other shapes of a bundle: C99, the ORT format for a reduced build of ONNX Runtime, a folder for a model hub."""

import math
import shutil
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from softslide.features.card import Card, write_card
from softslide.features.errors import InputError
from softslide.models.export.bundle import (
    PARITY,
    graph_inputs,
    read_graph,
    relative_differences,
    session_of,
    with_graph,
)
from softslide.models.export.c_code import sources
from softslide.models.export.forests import without_forests
from softslide.models.export.hub_card import page
from softslide.models.graph.optimized import optimized
from softslide.models.held_out import believed
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.pipeline.staging import staged
from softslide.serve.bundle import open_bundle

# Of the sample's recordings one in so many is compared: fifteen, of every split.
EVERY = 4


def export(model: str | Path, to: str, out: str | Path) -> dict[str, Any]:
    """Writes the bundle in another format, whole or not at all, and returns what there is to say about it.

    Raises:
        InputError: the bundle is not what it should be, or the format is impossible for its model.
    """
    card, _ = open_bundle(model)
    path = Path(model) / "model.onnx"
    if not path.is_file():
        raise InputError(f"{path}: no such file; name the bundle that 'softslide train' wrote")
    shapes = {"ort": _as_ort, "c": _as_c, "hub": _for_hub}
    if to not in shapes:
        raise InputError(f"{to}: name ort, c or hub", "to")
    return shapes[to](card, path, Path(out))


def _as_c(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """model.c and model.h, check.c that works the card's example with them, and the card as it is.

    In single precision where that gives the same rows, else in that of the graph.
    """
    graph = read_graph(path.parent)
    single = in_single(graph)
    differs = precision_difference(card, graph, single)
    try:
        files, figures = sources(of_one_window(single if differs <= PARITY else graph), card)
    except ValueError as error:
        raise InputError(
            f"{path}: cannot be written in C ({error}); use the ORT format on a small processor"
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
    # Its outputs mean what the card's do.
    if (folder.sensor.channels, folder.sensor.touch_axes) == (card.channels, card.conditioning.touch_axes):
        some = replace(folder, manifest=folder.manifest.iloc[::EVERY])
        windows = labelled_windows(some, card.conditioning, (0.6, 0.8, 1.0))
        more = graph_inputs(card.input, windows.volts, windows.elapsed_s)
        inputs = {name: np.concatenate([value, more[name]]) for name, value in inputs.items()}
    rows, other = (_rows(content.SerializeToString(), inputs) for content in (graph, single))
    stands = believed(rows, card.outputs, card.validity)
    return float(relative_differences(other[stands], rows[stands]).max()) if stands.any() else math.inf


def _rows(graph: bytes, inputs: dict[str, np.ndarray]) -> np.ndarray:
    """Rows (n, K) of a graph, one window at a time, as on a device."""
    session = session_of(graph)
    count = len(next(iter(inputs.values())))
    return np.concatenate(
        [session.run(None, {k: v[n : n + 1] for k, v in inputs.items()})[0] for n in range(count)]
    )


def of_one_window(graph: onnx.ModelProto) -> onnx.ModelProto:
    """The graph for one window at a time in standard operators, what is constant computed.

    Raises:
        ValueError: a forest has no such form.
    """
    one = without_forests(graph)
    given = {item.name for item in one.graph.initializer}
    inputs = [value for value in one.graph.input if value.name not in given]
    for value in (*inputs, *one.graph.output):
        value.type.tensor_type.shape.dim[0].dim_value = 1
    del one.graph.input[:]
    one.graph.input.extend(inputs)
    return onnx.load_model_from_string(optimized(one.SerializeToString()))


def in_single(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph with every float64 constant and value as float32: half the memory, and the only precision that a
    small processor's floating-point unit has."""
    single = onnx.ModelProto()
    single.CopyFrom(model)
    graph = single.graph
    # Types noted between nodes no longer hold; they follow from the rest.
    del graph.value_info[:]
    for item in graph.initializer:
        _narrow(item)
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.type == onnx.AttributeProto.TENSOR:
                _narrow(attribute.t)
            elif node.op_type == "Cast" and attribute.name == "to" and attribute.i == TensorProto.DOUBLE:
                attribute.CopyFrom(helper.make_attribute("to", TensorProto.FLOAT))
    return single


def _narrow(item: onnx.TensorProto) -> None:
    if item.data_type == TensorProto.DOUBLE:
        with np.errstate(over="ignore"):
            item.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(item).astype(np.float32), item.name))


def _as_ort(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """model.ort, and required_operators.config for ONNX Runtime's --include_ops_by_config."""
    small = optimized(path.read_bytes(), "ORT")
    operators = _operators(onnx.load_model_from_string(optimized(path.read_bytes())))
    with staged(out) as folder:
        (folder / "model.ort").write_bytes(small)
        (folder / "required_operators.config").write_text("\n".join(operators) + "\n", encoding="utf-8")
        write_card(with_graph(card, small), folder / "model.json")
    return {"shape": "ort", "model_kb": len(small) / 1e3, "operators": operators}


def _for_hub(card: Card, path: Path, out: Path) -> dict[str, Any]:
    """The bundle as it is, and its page."""
    with staged(out) as folder:
        for name in ("model.onnx", "model.json"):
            shutil.copyfile(path.parent / name, folder / name)
        (folder / "README.md").write_text(page(card), encoding="utf-8")
    return {"shape": "hub", "model_kb": path.stat().st_size / 1e3}


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

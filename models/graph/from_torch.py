"""Torch to ONNX, one file, any batch, as few bytes as will do."""

import tempfile
import warnings
from pathlib import Path

import onnx
import torch

from softslide.features.window import WINDOW_BINS
from softslide.models.graph.optimized import optimized
from softslide.models.graph.packing import pack


def export_graph(network: torch.nn.Module, accelerometers: int) -> onnx.ModelProto:
    """The graph of a network that reads windows: volts (B, 3 A, 64), elapsed_s (B,), weight (B, A) -> estimate."""
    example = (
        0.05 * torch.randn(3, 3 * accelerometers, WINDOW_BINS, generator=torch.Generator().manual_seed(0)),
        torch.tensor([3.0, 5.0, 9.0]),
        torch.ones(3, accelerometers),
    )
    names = ["volts", "elapsed_s", "weight"]
    # By tracing: the exporter that follows the program takes twenty times as long for the same numbers.
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as scratch:
        warnings.simplefilter("ignore")
        written = Path(scratch) / "model.onnx"
        torch.onnx.export(
            network,
            example,
            written,
            dynamo=False,
            opset_version=20,  # the newest that it knows
            input_names=names,
            output_names=["estimate"],
            dynamic_axes={name: {0: "batch"} for name in (*names, "estimate")},
        )
        graph = onnx.load_model_from_string(optimized(written.read_bytes()))
    strip(graph, set(network.state_dict()))
    pack(graph)
    onnx.checker.check_model(graph, full_check=True)
    return graph


def strip(graph: onnx.ModelProto, learned: set[str]) -> None:
    """Drops shapes in between, domains of no operator, and the long names of all that is neither in `learned` nor an
    input or an output; equal constants become one."""
    kept = learned | {item.name for item in (*graph.graph.input, *graph.graph.output)}
    short: dict[str, str] = {"": ""}
    constants: dict[bytes, str] = {}
    for item in list(graph.graph.initializer):
        if item.name in kept:
            continue
        name, item.name = item.name, ""
        value = item.SerializeToString()
        if value in constants:
            graph.graph.initializer.remove(item)
        short[name] = item.name = constants.setdefault(value, f"k{len(constants):x}")
    del graph.graph.value_info[:]
    domains = [opset for opset in graph.opset_import if not opset.domain]
    del graph.opset_import[:]
    graph.opset_import.extend(domains)
    for node in graph.graph.node:
        node.name = ""
        for names in (node.input, node.output):
            names[:] = [name if name in kept else short.setdefault(name, f"{len(short):x}") for name in names]

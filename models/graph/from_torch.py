"""Torch to ONNX, one file, any batch, as few bytes as will do."""

import contextlib
import io
import logging
import warnings

import onnx
import torch

from softslide.features.window import WINDOW_BINS
from softslide.models.graph.packing import pack


def export_graph(network: torch.nn.Module, accelerometers: int) -> onnx.ModelProto:
    """The graph of a network that reads windows: volts (B, 3 A, 64), elapsed_s (B,), weight (B, A) -> estimate."""
    example = (
        0.05 * torch.randn(3, 3 * accelerometers, WINDOW_BINS, generator=torch.Generator().manual_seed(0)),
        torch.tensor([3.0, 5.0, 9.0]),
        torch.ones(3, accelerometers),
    )
    batch = torch.export.Dim("batch")
    # The exporter speaks of its own progress and of packages that are not needed.
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            network,
            example,
            dynamo=True,
            external_data=False,
            input_names=["volts", "elapsed_s", "weight"],
            output_names=["estimate"],
            dynamic_shapes=({0: batch}, {0: batch}, {0: batch}),
            verbose=False,
        )
    assert program is not None
    graph = program.model_proto
    strip(graph)
    pack(graph)
    onnx.checker.check_model(graph, full_check=True)
    return graph


def strip(graph: onnx.ModelProto) -> None:
    """Drops the exporter's notes (source lines, scopes, shapes in between) and its long names of what lies between
    operators: two thirds of a small model's bytes."""
    kept = {item.name for item in (*graph.graph.initializer, *graph.graph.input, *graph.graph.output)}
    short: dict[str, str] = {"": ""}
    del graph.graph.value_info[:]
    for node in graph.graph.node:
        del node.metadata_props[:]
        node.doc_string = ""
        node.name = ""
        for names in (node.input, node.output):
            names[:] = [name if name in kept else short.setdefault(name, f"{len(short):x}") for name in names]
    for item in (*graph.graph.initializer, *graph.graph.input, *graph.graph.output):
        item.doc_string = ""
        del item.metadata_props[:]
    del graph.graph.metadata_props[:]

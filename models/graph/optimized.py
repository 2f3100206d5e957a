"""A graph as ONNX Runtime simplifies it: what is constant computed, what does nothing left out."""

import tempfile
from pathlib import Path

import onnxruntime as ort


def optimized(graph: bytes, form: str = "ONNX") -> bytes:
    """The graph in the form ONNX or ORT, with basic optimizations only: what goes beyond is chosen for the processor at
    hand."""
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_BASIC
    options.add_session_config_entry("session.save_model_format", form)
    options.log_severity_level = 4
    # ONNX Runtime writes to files alone, and does not say why it cannot: not where the output goes.
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "model"
        options.optimized_model_filepath = str(target)
        ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        return target.read_bytes()

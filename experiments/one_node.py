"""A graph of one node, whose call is the unit in which a runtime's times are compared between computers."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from softslide.serve.bundle import open_session

# A graph of one Identity over one float32 (opset 18), serialized, so that only ONNX Runtime is needed.
ONE_NODE = (
    b'\x08\x08:7\n\x10\n\x01x\x12\x01y"\x08Identity\x12\x01oZ\x0f\n\x01x\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01'
    b"b\x0f\n\x01y\x12\n\n\x08\x08\x01\x12\x04\n\x02\x08\x01B\x04\n\x00\x10\x12"
)


def one_node() -> Callable[[], object]:
    """A call of it."""
    return partial(open_session(ONE_NODE, Path("one node")).run, None, {"x": np.zeros(1, np.float32)})

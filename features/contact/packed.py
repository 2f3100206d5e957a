"""Arrays of numbers as texts of a JSON file, in few bytes."""

import base64
import math
import zlib
from typing import Any

import numpy as np


def packed(values: np.ndarray) -> str:
    """An array's bytes as a text: compressed by zlib, in base85."""
    return base64.b85encode(zlib.compress(values.tobytes(), 9)).decode("ascii")


def unpacked(text: str, kind: Any, shape: tuple[int, ...]) -> np.ndarray:
    """The array (shape) of this NumPy type from its text; no more is unpacked than it holds.

    Raises:
        ValueError: the text is damaged, or holds fewer or more numbers.
    """
    size = math.prod(shape) * np.dtype(kind).itemsize
    try:
        content = zlib.decompressobj().decompress(base64.b85decode(text), size + 1)
    except zlib.error as error:
        raise ValueError(f"numbers of a map are damaged ({error})") from None
    if len(content) != size:
        raise ValueError(f"a map does not hold the {math.prod(shape)} numbers that its knots ask for")
    return np.frombuffer(content, dtype=kind).reshape(shape)

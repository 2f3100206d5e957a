"""What a graph may ask for, read from model.onnx before ONNX Runtime builds it.

The file is a protocol buffer (onnx.proto3 of ONNX); the few fields that matter are read here, since the package `onnx`
is not on a device. The limits are orders of magnitude beyond the project's own models. They keep out what would exhaust
memory by its shapes alone, and control flow, which need not end; the bundle's example is also run against a clock.
"""

import math
import re
import struct
from collections.abc import Iterator

MOST_BYTES = 1 << 28
MOST_NODES = 100_000
# Elements that one shape in the graph may ask for: 64 MB in single precision.
MOST_ELEMENTS = 1 << 24
# Versions that ONNX Runtime 1.31 knows; a newer one is its to refuse.
NEWEST = {"": 27, "ai.onnx": 27, "ai.onnx.ml": 6, "com.microsoft": 1}
# Of the one operator of ONNX Runtime's own that earlier bundles have.
OWN, OWN_OPERATOR = "com.microsoft", "Inverse"
# Which input of an operator is a shape or a number of repeats.
SHAPE_INPUT = {"ConstantOfShape": 0, "Expand": 1, "Reshape": 1, "Tile": 1, "Pad": 1, "Resize": 3}
# A tensor's kind, in both formats, and the length up to which one is read: no shape is longer.
INT64, SHORT_BYTES = 7, 64

# An attribute's lists of floats, whole numbers and short words, a field each: trees have hundreds of thousands.
_WORD = b"|".join(b"%c.{%d}" % (size, size) for size in range(32))
_LISTS = re.compile(rb"(?:\x3d.{4}|\x40[\x80-\xff]{0,9}[\x00-\x7f]|\x4a(?:" + _WORD + rb"))*+", re.DOTALL)

Fields = Iterator[tuple[int, int | bytes]]


def check_onnx(graph: bytes) -> None:
    """Checks a model.onnx.

    Raises:
        ValueError: operators of unknown domains or versions; data outside the file; too many nodes, control flow, or a
            shape that is too large.
        IndexError, struct.error: no ONNX graph.
    """
    for key, value in _fields(graph):
        if key == 8:
            domain, version = "", 0
            for inner, item in _fields(_bytes(value)):
                domain = _bytes(item).decode() if inner == 1 else domain
                version = _whole(item) if inner == 2 else version
            if not 1 <= version <= NEWEST.get(domain, 0):
                raise ValueError(f"operators of '{domain or 'ai.onnx'}' {version}")
        elif key == 25:
            raise ValueError("it defines operators of its own")
        elif key == 7:
            _check_graph(_bytes(value))


def _check_graph(content: bytes) -> None:
    nodes = 0
    asked: list[tuple[str, bytes]] = []
    constants: dict[bytes, list[int]] = {}
    for key, value in _fields(content):
        if key == 1:
            nodes += 1
            asked += _check_node(_bytes(value), constants)
        elif key == 5:
            _note_tensor(_bytes(value), constants)
        elif key == 15:
            raise ValueError("a constant is sparse")
    if nodes > MOST_NODES:
        raise ValueError(f"more than {MOST_NODES} nodes")
    check_sizes(asked, constants)


def check_sizes(asked: list[tuple[str, bytes]], constants: dict[bytes, list[int]]) -> None:
    """Checks the shapes that operators ask for. asked: operator, and name of the constant with the shape."""
    for operator, name in asked:
        if math.prod(max(1, abs(v)) for v in constants.get(name, ())) > MOST_ELEMENTS:
            raise ValueError(f"{operator} asks for more than {MOST_ELEMENTS} elements")


def check_domain(operator: str, domain: str) -> None:
    """Checks that an operator is one of a domain that bundles use."""
    if domain not in NEWEST or (domain == OWN and operator != OWN_OPERATOR):
        raise ValueError(f"operator {operator} of '{domain}'")


def _check_node(content: bytes, constants: dict[bytes, list[int]]) -> list[tuple[str, bytes]]:
    """The operator with the name of the constant that says how much it makes, if it is of that kind."""
    inputs, outputs, attributes, operator, domain = [], [], [], "", ""
    for key, value in _fields(content):
        if key == 1:
            inputs.append(_bytes(value))
        elif key == 2:
            outputs.append(_bytes(value))
        elif key == 4:
            operator = _bytes(value).decode()
        elif key == 5:
            attributes.append(_bytes(value))
        elif key == 7:
            domain = _bytes(value).decode()
    check_domain(operator, domain)
    for attribute in attributes:
        for key, value in _fields(attribute, _LISTS):
            if key in (6, 11):
                raise ValueError(f"control flow, operator {operator}")
            elif key in (5, 10):
                _note_tensor(_bytes(value), constants, outputs[0] if outputs else b"")
            elif key in (22, 23):
                raise ValueError("a constant is sparse")
    place = SHAPE_INPUT.get(operator)
    return [(operator, inputs[place])] if place is not None and len(inputs) > place else []


def _note_tensor(content: bytes, constants: dict[bytes, list[int]], name: bytes = b"") -> None:
    """Notes the values of a short list of int64; name: in place of the tensor's own."""
    kind, values, raw, dims = 0, [], b"", []
    for key, value in _fields(content):
        if key == 1:
            dims += _packed(value)
        elif key == 2:
            kind = _whole(value)
        elif key == 7:
            values += _packed(value)
        elif key == 8:
            name = name or _bytes(value)
        elif key == 9:
            raw = _bytes(value)
        elif key == 13 or (key == 14 and value != 0):
            raise ValueError("a constant lies in another file")
    if any(size < 0 for size in dims) or math.prod(dims) > MOST_BYTES:
        raise ValueError("a constant is too large")
    if kind == INT64 and len(raw) % 8 == 0 and len(raw) <= SHORT_BYTES:
        constants[name] = values or list(struct.unpack(f"<{len(raw) // 8}q", raw))


def _fields(content: bytes, skipped: re.Pattern[bytes] = re.compile(b"")) -> Fields:
    """The fields of a message in their order: its number, and a whole number or the bytes of it; skipped: others."""
    at = 0
    while (at := _end(skipped, content, at)) < len(content):
        tag, at = _varint(content, at)
        number, form = tag >> 3, tag & 7
        if form == 0:
            value, at = _varint(content, at)
            yield number, value
        else:
            size, at = (8, at) if form == 1 else (4, at) if form == 5 else _varint(content, at)
            if form not in (1, 2, 5) or at + size > len(content):
                raise ValueError("damaged")
            yield number, content[at : at + size]
            at += size


def _end(pattern: re.Pattern[bytes], content: bytes, at: int) -> int:
    match = pattern.match(content, at)
    return at if match is None else match.end()


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, the lowest first, and the place after it."""
    value = 0
    for n in range(10):
        byte = content[at + n]
        value |= (byte & 0x7F) << 7 * n
        if byte < 0x80:
            return value, at + n + 1
    raise ValueError("damaged")


def _packed(value: int | bytes) -> list[int]:
    """A repeated int64, one of them or several in a row."""
    numbers, at = [], 0
    if isinstance(value, int):
        return [_signed(value)]
    while at < len(value):
        number, at = _varint(value, at)
        numbers.append(_signed(number))
    return numbers


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value


def _bytes(value: int | bytes) -> bytes:
    if isinstance(value, bytes):
        return value
    raise ValueError("damaged")


def _whole(value: int | bytes) -> int:
    if isinstance(value, int):
        return value
    raise ValueError("damaged")

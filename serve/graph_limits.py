"""What a graph may ask for, read from model.onnx before ONNX Runtime builds it.

The file is a protocol buffer (onnx.proto3 of ONNX); the few fields that matter are read here, since the package `onnx`
is not on a device. The limits are orders of magnitude beyond the project's own models. They keep out control flow,
which need not end, and single operators and constants that would exhaust memory. They do not see what grows from
operator to operator, by joining and by products; the bundle's example is also run against a clock.
"""

import math
import re
import struct
from collections.abc import Iterator

MOST_BYTES = 1 << 28
MOST_NODES = 100_000
# Elements that one operator may ask for: 64 MB in single precision.
MOST_ELEMENTS = 1 << 24
# Versions that ONNX Runtime 1.31 knows; a newer one is its to refuse.
NEWEST = {"": 27, "ai.onnx": 27, "ai.onnx.ml": 6, "com.microsoft": 1}
# Which input of an operator is a size.
SIZE_INPUT = {"ConstantOfShape": 0, "Expand": 1, "Pad": 1, "Tile": 1}
# All others make no more than what they read holds, joined, multiplied or broadcast. The models here export some thirty
# of them; the rest are what another model may take.
_STANDARD = """
Abs Acos Add And Asin Atan Cast Ceil Clip Cos Cosh Div Elu Equal Erf Exp Floor Gelu Greater GreaterOrEqual HardSigmoid
HardSwish Identity IsInf IsNaN LeakyRelu Less LessOrEqual Log Max Mean Min Mish Mod Mul Neg Not Or PRelu Pow Reciprocal
Relu Round Selu Sigmoid Sign Sin Sinh Softplus Softsign Sqrt Sub Sum Tan Tanh Where Xor
ArgMax ArgMin AveragePool CumSum GlobalAveragePool GlobalMaxPool LogSoftmax MaxPool ReduceL1 ReduceL2 ReduceLogSum
ReduceLogSumExp ReduceMax ReduceMean ReduceMin ReduceProd ReduceSum ReduceSumSquare Softmax
BatchNormalization Conv Einsum Gemm LayerNormalization MatMul
Concat Constant Flatten Gather GatherElements GatherND Reshape Shape Size Slice Split Squeeze TopK Transpose Unsqueeze
"""
TREES = "TreeEnsembleRegressor"
_ONNX = frozenset((*SIZE_INPUT, *_STANDARD.split()))
OPERATORS = {
    "": _ONNX,
    "ai.onnx": _ONNX,
    "ai.onnx.ml": {"LinearRegressor", TREES},
    # Of ONNX Runtime's own; earlier bundles have it.
    "com.microsoft": {"Inverse"},
}
CONSTANT = "Constant"
# A tensor's kind, in both formats, and how many numbers are read at most: no size and no shape has more.
INT64, MOST_SIZES = 7, 32

# A forest's lists of floats, whole numbers and short words, a field each: hundreds of thousands.
_WORD = b"|".join(b"%c.{%d}" % (size, size) for size in range(32))
_LISTS = re.compile(rb"(?:\x3d.{4}|\x40[\x80-\xff]{0,9}[\x00-\x7f]|\x4a(?:" + _WORD + rb"))*+", re.DOTALL)
_NOTHING = re.compile(b"")

Fields = Iterator[tuple[int, int | bytes]]
# Values of short constants of int64 by name; of other constants none.
Constants = dict[bytes, list[int] | None]


def check_onnx(graph: bytes) -> None:
    """Checks a model.onnx.

    Raises:
        ValueError: unknown operators or versions of them; data outside the file; too many nodes, control flow, or a
            size that is too large or computed.
        IndexError, struct.error: no ONNX graph.
    """
    graphs = []
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
            graphs.append(_bytes(value))
    # A reader joins several; which of their parts hold is not asked here.
    if len(graphs) != 1:
        raise ValueError(f"{len(graphs)} graphs")
    _check_graph(graphs[0])


def _check_graph(content: bytes) -> None:
    nodes = 0
    asked: list[tuple[str, bytes]] = []
    constants: Constants = {}
    for key, value in _fields(content):
        if key == 1:
            nodes += 1
            check_nodes(nodes)
            asked += _check_node(_bytes(value), constants)
        elif key == 5:
            note(constants, *_tensor(_bytes(value)))
        elif key == 15:
            raise ValueError("a constant is sparse")
    check_sizes(asked, constants)


def check_nodes(count: int) -> None:
    """Checks how many nodes a graph has."""
    if count > MOST_NODES:
        raise ValueError(f"more than {MOST_NODES} nodes")


def check_operator(operator: str, domain: str) -> None:
    """Checks that an operator is one that bundles use."""
    if operator not in OPERATORS.get(domain, ()):
        raise ValueError(f"operator {operator[:40]} of '{domain[:40]}'")


def check_sizes(asked: list[tuple[str, bytes]], constants: Constants) -> None:
    """Checks the sizes that operators ask for. asked: operator, and name of the constant with the size."""
    for operator, name in asked:
        values = constants.get(name)
        if values is None:
            raise ValueError(f"{operator} takes a size that is no short constant")
        check_elements(operator, values)


def check_elements(asking: str, sizes: list[int], most: int = MOST_ELEMENTS) -> None:
    """Checks that sizes are few and their product is at most `most`. asking: begins the error."""
    # Few first: the product of many has any number of digits.
    if len(sizes) > MOST_SIZES or math.prod(max(1, abs(size)) for size in sizes) > most:
        raise ValueError(f"{asking} asks for more than {most} elements or {MOST_SIZES} dimensions")


def note(constants: Constants, name: bytes, values: list[int] | None) -> None:
    """Notes a constant; of two by one name nobody knows which one holds."""
    if name in constants:
        raise ValueError("two constants have one name")
    constants[name] = values


def _check_node(content: bytes, constants: Constants) -> list[tuple[str, bytes]]:
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
    check_operator(operator, domain)
    for attribute in attributes:
        numbers: list[int] = []
        for key, value in _fields(attribute, _LISTS if operator == TREES else _NOTHING):
            if key == 3 or (key == 8 and operator != TREES):
                numbers += _packed(value)
            elif key == 5:
                _, values = _tensor(_bytes(value))
                if operator == CONSTANT:
                    note(constants, outputs[0], values)
            elif key in (6, 10, 11, 22, 23):
                raise ValueError(f"{operator} holds a graph, several constants or a sparse one")
        check_elements(operator, numbers)
    place = SIZE_INPUT.get(operator)
    return [(operator, b"".join(inputs[place : place + 1]))] if place is not None else []


def _tensor(content: bytes) -> tuple[bytes, list[int] | None]:
    """The name of a constant, and its values if it is a short list of int64."""
    kind, values, raw, dims, name = 0, [], None, [], b""
    for key, value in _fields(content):
        if key == 1:
            dims += _packed(value)
        elif key == 2:
            kind = _whole(value)
        elif key == 7:
            values += _packed(value)
        elif key == 8:
            name = _bytes(value)
        elif key == 9:
            raw = _bytes(value)
        elif key == 13 or (key == 14 and value != 0):
            raise ValueError("a constant lies in another file")
    if 0 not in dims:
        # A word takes two bytes or more, the smallest number half a byte.
        check_elements("a constant", dims, 2 * len(content))
    if raw is not None:
        # As a reader does: bytes go before numbers.
        values = list(struct.unpack_from(f"<{min(len(raw) // 8, MOST_SIZES + 1)}q", raw))
    return name, values if kind == INT64 and len(values) <= MOST_SIZES else None


def _fields(content: bytes, skipped: re.Pattern[bytes] = _NOTHING) -> Fields:
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
            # A number of fixed length is none of those that are asked for.
            if form == 2:
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
    """A repeated int64, one of them or several in a row; of many the first MOST_SIZES + 1."""
    numbers: list[int] = []
    at = 0
    if isinstance(value, int):
        return [_signed(value)]
    while at < len(value) and len(numbers) <= MOST_SIZES:
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

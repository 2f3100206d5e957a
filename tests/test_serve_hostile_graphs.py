"""A graph that does other work than a bundle's, under a card that fits it: refused before it is built."""

import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from altered_bundle import taken
from onnx import TensorProto, helper, numpy_helper
from small_bundle import resigned

import softslide
from softslide.features.errors import InputError
from softslide.models.graph.optimized import optimized
from softslide.serve.localizer import Localizer


def int64(values: list[int], name: str) -> onnx.TensorProto:
    return numpy_helper.from_array(np.array(values, np.int64), name)


def tensor(name: str, shape: list[Any] | None, kind: int = TensorProto.FLOAT) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, kind, shape)


def hostile(*nodes: onnx.NodeProto, opset: int = 18, **constants: list[int]) -> onnx.ModelProto:
    """A graph with the inputs and the output of a bundle's."""
    inputs = [tensor("volts", ["B", 3, 64]), tensor("elapsed_s", ["B"]), tensor("weight", ["B", 1])]
    given = [int64(values, name) for name, values in constants.items()]
    graph = helper.make_graph(nodes, "hostile", inputs, [tensor("estimate", ["B", 5])], given)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)


def endless() -> onnx.ModelProto:
    """Turns a loop 2^60 times."""
    nodes = [helper.make_node("Identity", ["on"], ["on_2"]), helper.make_node("Add", ["x", "x"], ["y"])]
    counted, on = tensor("n", [], TensorProto.INT64), tensor("on", [], TensorProto.BOOL)
    ends = [tensor("on_2", [], TensorProto.BOOL), tensor("y", None)]
    body = helper.make_graph(nodes, "body", [counted, on, tensor("x", None)], ends)
    loop = helper.make_node("Loop", ["turns", "", "volts"], ["estimate"], body=body)
    return hostile(loop, turns=[1 << 60])


TERABYTES = [1 << 20, 1 << 20, 1]
EXPAND = (
    helper.make_node("ReduceSum", ["volts"], ["one"], keepdims=0),
    helper.make_node("Expand", ["one", "size"], ["estimate"]),
)


def counted() -> onnx.ModelProto:
    """Turns a loop as often as its input says."""
    model = endless()
    model.graph.initializer.pop()
    whole = helper.make_node("Cast", ["elapsed_s"], ["many"], to=TensorProto.INT64)
    model.graph.node.insert(0, helper.make_node("ReduceMax", ["many"], ["turns"], keepdims=0))
    model.graph.node.insert(0, whole)
    return model


def huge() -> onnx.ModelProto:
    """Makes a matrix of 3 TB."""
    return hostile(*EXPAND, size=TERABYTES)


def huge_by_node() -> onnx.ModelProto:
    """The same size from a node Constant."""
    size = helper.make_node("Constant", [], ["size"], value=int64(TERABYTES, "unnamed"))
    return hostile(size, *EXPAND)


def elsewhere() -> onnx.ModelProto:
    """A constant in another file."""
    model = hostile(helper.make_node("Add", ["volts", "k"], ["estimate"]), k=[1])
    constant = model.graph.initializer[0]
    constant.data_location = TensorProto.EXTERNAL
    constant.external_data.add(key="location", value="/etc/passwd")
    return model


def foreign() -> onnx.ModelProto:
    """An operator of nobody's."""
    return hostile(helper.make_node("Run", ["volts"], ["estimate"], domain="evil.example"))


def of_the_runtimes_own() -> onnx.ModelProto:
    """An operator of ONNX Runtime's own that no bundle has."""
    model = hostile(helper.make_node("FastGelu", ["volts"], ["estimate"], domain="com.microsoft"))
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    return model


def newer() -> onnx.ModelProto:
    """Operators of a version that is not out."""
    return hostile(helper.make_node("Identity", ["volts"], ["estimate"]), opset=99)


def more_dimensions() -> onnx.ModelProto:
    """The same size with more numbers than any has."""
    return hostile(*EXPAND, size=[*TERABYTES, *[1] * 40])


def nine_dimensions() -> onnx.ModelProto:
    """The same size with six dimensions more."""
    return hostile(*EXPAND, size=[*TERABYTES, *[1] * 6])


def drawn() -> onnx.ModelProto:
    """A size in an operator's attribute."""
    noise = helper.make_node("RandomNormal", [], ["noise"], shape=TERABYTES)
    return hostile(noise, helper.make_node("ReduceSum", ["noise"], ["estimate"]))


def padded() -> onnx.ModelProto:
    """A border in an operator's attribute."""
    conv = helper.make_node("Conv", ["volts", "weights"], ["estimate"], pads=[1 << 40, 0])
    model = hostile(conv)
    model.graph.initializer.append(numpy_helper.from_array(np.ones((1, 3, 1), np.float32), "weights"))
    return model


def planted() -> onnx.ModelProto:
    """A forest of 2^40 targets."""
    forest = helper.make_node(
        "TreeEnsembleRegressor", ["volts"], ["estimate"], domain="ai.onnx.ml", n_targets=1 << 40
    )
    model = hostile(forest)
    model.opset_import.append(helper.make_opsetid("ai.onnx.ml", 3))
    return model


MADE = (endless, counted, huge, huge_by_node, elsewhere, foreign, of_the_runtimes_own, newer)
SIZED = (more_dimensions, nine_dimensions, drawn, padded, planted)


def refusal(bundle: Path, graph: bytes) -> str:
    resigned(bundle, graph)
    with pytest.raises(InputError, match="no graph that this release runs") as error:
        Localizer.load(bundle)
    return str(error.value)


@pytest.mark.parametrize("made", [*MADE, *SIZED])
def test_a_hostile_graph_with_a_fitting_card_is_refused_before_it_is_built(mine: Path, made: Any) -> None:
    assert "damaged" not in refusal(mine, made().SerializeToString())


IN_ORT = (endless, counted, huge, huge_by_node, of_the_runtimes_own, nine_dimensions, drawn, padded)


@pytest.mark.parametrize("made", IN_ORT)
def test_the_same_is_refused_in_the_ort_format(mine: Path, made: Any) -> None:
    resigned(mine, optimized(made().SerializeToString(), "ORT"))
    (mine / "model.onnx").rename(mine / "model.ort")
    with pytest.raises(InputError, match=r"model\.ort: no graph that this release runs \((?!damaged)"):
        Localizer.load(mine)


@pytest.mark.parametrize("kind", ["Range", "OneHot", "EyeLike", "Resize", "NonZero", "ConvTranspose"])
def test_what_makes_more_than_it_reads_is_no_operator_of_a_bundle(mine: Path, kind: str) -> None:
    said = refusal(mine, hostile(helper.make_node(kind, ["volts"], ["estimate"])).SerializeToString())
    assert f"operator {kind} of" in said


SIZES = (
    helper.make_node("Identity", ["part"], ["size"]),
    helper.make_node("Concat", ["part", "part"], ["size"], axis=0),
    helper.make_node("Constant", [], ["size"], value_ints=[5, 5]),
    helper.make_node("Shape", ["volts"], ["size"]),
    helper.make_node("Constant", [], ["size"], value=numpy_helper.from_array(np.ones(1, np.int32))),
)


@pytest.mark.parametrize("size", SIZES, ids=lambda node: node.op_type)
@pytest.mark.parametrize("kind", ["Expand", "Tile", "Pad", "ConstantOfShape"])
def test_a_size_that_is_not_read_is_refused_however_small(
    mine: Path, size: onnx.NodeProto, kind: str
) -> None:
    inputs = ["size"] if kind == "ConstantOfShape" else ["volts", "size"]
    graph = hostile(size, helper.make_node(kind, inputs, ["estimate"]), part=[1])
    assert f"{kind} takes a size that is no short constant" in refusal(mine, graph.SerializeToString())


def test_a_size_is_the_one_that_onnx_runtime_reads(mine: Path) -> None:
    """Bytes before numbers, the last name of several; of two constants or graphs by one name it is not asked which."""
    small, large = int64([1], "size"), int64(TERABYTES, "size")
    both = int64(TERABYTES, "size")
    both.int64_data.append(1)
    renamed = onnx.TensorProto.FromString(large.SerializeToString())
    renamed.ClearField("name")
    # A number of fixed length in place of the bytes of a value: none.
    fixed = large.SerializeToString() + b"\x49" + (1).to_bytes(8, "little")
    cases = {
        "asks for more": [both.SerializeToString()],
        "Expand asks for": [
            int64([1], "other").SerializeToString(),
            b"\x42\x05other" + large.SerializeToString(),
        ],
        "asks for": [fixed],
        "one name": [small.SerializeToString(), large.SerializeToString()],
    }
    for reason, constants in cases.items():
        graph = hostile(*EXPAND).graph.SerializeToString() + b"".join(map(initializer, constants))
        assert reason in refusal(mine, of_graphs(graph))


def initializer(content: bytes) -> bytes:
    return field(5, content)


def field(number: int, content: bytes) -> bytes:
    """A record of a message."""
    size, length = b"", len(content)
    while length > 127:
        size, length = size + bytes([length & 127 | 128]), length >> 7
    return bytes([number << 3 | 2]) + size + bytes([length]) + content


def of_graphs(*graphs: bytes) -> bytes:
    """A model with graphs, each a record of its own."""
    model = hostile()
    model.ClearField("graph")
    return model.SerializeToString() + b"".join(field(7, graph) for graph in graphs)


def test_a_graph_in_two_records_is_refused(mine: Path) -> None:
    parts = (
        hostile(*EXPAND).graph.SerializeToString(),
        initializer(int64(TERABYTES, "size").SerializeToString()),
    )
    assert onnx.load_model_from_string(of_graphs(*parts)).graph.initializer[0].name == "size"
    assert "2 graphs" in refusal(mine, of_graphs(*parts))


def test_limits_are_found_without_working_beyond_them(mine: Path) -> None:
    """Dimensions whose product has 600,000 digits, four million nodes, and a constant that claims what it lacks."""
    many, words = TensorProto(name="k", data_type=1), TensorProto(name="k", data_type=TensorProto.STRING)
    many.dims.extend([1 << 62] * 30_000)
    words.dims.append(1 << 27)
    nodes = field(1, helper.make_node("Abs", ["volts"], ["estimate"]).SerializeToString()) * 4_000_000
    begun = time.process_time()
    for content, reason in (
        (initializer(many.SerializeToString()), "a constant asks for more"),
        (initializer(words.SerializeToString()), "a constant asks for more"),
        (nodes, "more than 100000 nodes"),
        (b"\x0a\x00" * 4_000_000, "operator  of"),
    ):
        assert reason in refusal(mine, of_graphs(content))
    assert time.process_time() - begun < 6.0


def test_a_damaged_graph_in_the_ort_format_is_one_line_or_runs(mine: Path) -> None:
    graph, chance = optimized((mine / "model.onnx").read_bytes(), "ORT"), random.Random(0)
    for _ in range(40):
        damaged = bytearray(graph)
        damaged[chance.randrange(min(len(graph), 4000))] ^= 1 << chance.randrange(8)
        resigned(mine, bytes(damaged))
        (mine / "model.onnx").rename(mine / "model.ort")
        taken(mine)
        (mine / "model.ort").rename(mine / "model.onnx")


def long_work() -> bytes:
    """A matrix of 4096 by 4096, the largest that a size may ask for, times itself a hundred times: minutes."""
    nodes = [
        helper.make_node("ReduceSum", ["volts"], ["one"], keepdims=0),
        helper.make_node("Expand", ["one", "size"], ["0"]),
        *(helper.make_node("MatMul", [str(n), "0"], [str(n + 1)]) for n in range(100)),
        helper.make_node("ReduceSum", ["100"], ["sum"], keepdims=0),
        helper.make_node("Unsqueeze", ["elapsed_s", "last"], ["column"]),
        helper.make_node("Concat", ["column"] * 5, ["row"], axis=1),
        helper.make_node("Add", ["row", "sum"], ["estimate"]),
    ]
    return hostile(*nodes, size=[4096, 4096], last=[1]).SerializeToString()


def long_reading() -> bytes:
    """A graph that names itself eight million times: seconds of reading alone."""
    return of_graphs(hostile(*EXPAND).graph.SerializeToString() + b"\x12\x00" * 8_000_000)


@pytest.mark.parametrize("made", [long_work, long_reading])
def test_work_without_end_that_no_size_shows_is_left_behind(mine: Path, made: Any) -> None:
    """The command ends all the same."""
    resigned(mine, made())
    command, root = [sys.executable, "-c", LOAD, str(mine)], Path(softslide.__file__).parents[1]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2, done.stderr
    assert "not loaded and run once in 1 s" in done.stdout


LOAD = """
import sys
from pathlib import Path
from softslide.features.errors import InputError
from softslide.serve import bundle
bundle.LOADING_S = 1.0
try:
    bundle.open_bundle(Path(sys.argv[1]))
except InputError as error:
    print(error)
    sys.exit(2)
"""

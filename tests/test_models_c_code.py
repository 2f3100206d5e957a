"""The generated C computes what ONNX Runtime does: operator by operator, and for every model."""

import hashlib
import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch
from bump_map import bump_map
from onnx import TensorProto
from slide_windows import labelled_slides
from small_bundle import write_small_bundle
from streams import a_sensor

import softslide
from features.card import Card, read_card
from models import classical, interpolation
from models.baselines import float_features
from models.c_code.memory import layout
from models.c_code.node import NoForm
from models.c_code.program import program
from models.c_code.source import sources
from models.c_code.tensors import Buffer
from models.classical import GpConfig, InterpolationConfig, MlpConfig, TreesConfig
from models.export import export_graph
from models.graph import OPSET, GraphBuilder
from models.network import OUTPUTS, NetworkConfig, SlideNetwork
from models.refinement import Refinement
from models.synthetic_windows import SynthesisConfig, WindowBatch, WindowSource
from models.training import TrainingConfig, train_proposal

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
ONNX_RUNTIME = "com.microsoft"
SANITIZED = (*STRICT, "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
RUN = """
#include "model.h"
#include <stdio.h>
int main(void)
{{
    static float x[{width}], y[{outputs}];
    while (fread(x, sizeof x, 1, stdin) == 1) {{
        softslide_estimate({arguments}, y);
        fwrite(y, sizeof y, 1, stdout);
    }}
    return 0;
}}
"""


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Card:
    """Any card: the code has names, units and an example from it."""
    bundle = write_small_bundle(tmp_path_factory.mktemp("bundle") / "b", a_sensor())
    return read_card(bundle / "model.json")


@dataclass(frozen=True)
class Case:
    """A graph and what it is run on."""

    graph: onnx.ModelProto
    inputs: dict[str, np.ndarray]

    def onnx_rows(self) -> np.ndarray:
        """ONNX Runtime's rows, one window at a time, as on a device."""
        session = ort.InferenceSession(self.graph.SerializeToString(), providers=["CPUExecutionProvider"])
        rows = len(next(iter(self.inputs.values())))
        return np.concatenate(
            [session.run(None, {k: v[n : n + 1] for k, v in self.inputs.items()})[0] for n in range(rows)]
        )

    def c_rows(self, folder: Path, card: Card, flags: tuple[str, ...] = STRICT) -> np.ndarray:
        """The generated code's rows, compiled and run as a process of its own."""
        example = {k: v[:1].tolist() for k, v in self.inputs.items()}
        outputs = self.graph.graph.output[0].type.tensor_type.shape.dim[1].dim_value
        golden = {"inputs": example, "estimate": [0.0] * outputs}
        files, _ = sources(self.graph, replace(card, golden=golden))
        flat = {k: v.reshape(len(v), -1) for k, v in self.inputs.items()}
        ends = np.cumsum([v.shape[1] for v in flat.values()])
        arguments = [
            f"x[{end - 1}]" if v.shape[1] == 1 else f"x + {end - v.shape[1]}"
            for v, end in zip(flat.values(), ends, strict=True)
        ]
        files["run.c"] = RUN.format(width=ends[-1], outputs=outputs, arguments=", ".join(arguments))
        for name, text in files.items():
            (folder / name).write_text(text)
        compiled(folder, "run", flags)
        given = np.hstack(list(flat.values())).astype(np.float32).tobytes()
        done = subprocess.run([folder / "run"], input=given, capture_output=True, check=True)
        return np.frombuffer(done.stdout, np.float32).reshape(-1, outputs)


def compiled(folder: Path, name: str, flags: tuple[str, ...] = STRICT) -> None:
    command = ["cc", *flags, "model.c", f"{name}.c", "-o", name, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stderr


def difference(rows: np.ndarray, wanted: np.ndarray) -> float:
    """Largest difference relative to max(1, |wanted|); NaN has to meet NaN, infinity infinity."""
    finite = np.isfinite(wanted)
    np.testing.assert_array_equal(rows[~finite], wanted[~finite])
    return float(np.max(np.abs(rows - wanted)[finite] / np.maximum(1, np.abs(wanted[finite])), initial=0.0))


def ints(g: GraphBuilder, *values: int) -> str:
    return g.constant(values, np.int64)


def randoms(g: GraphBuilder, *shape: int) -> str:
    return g.constant(np.random.default_rng(5).normal(size=shape).astype(np.float32), np.float32)


def truth(g: GraphBuilder, value: str) -> str:
    return g.cast(value, TensorProto.FLOAT)


def double(g: GraphBuilder, value: str) -> str:
    return g.cast(value, TensorProto.DOUBLE)


def whole(g: GraphBuilder, x: str) -> str:
    """0 or 1, or counted from the end."""
    low, high = (g.constant(bound, np.float32) for bound in (-2.0, 1.0))
    return g.cast(g.op("Clip", g.op("Floor", x), low, high), TensorProto.INT64)


def bright(g: GraphBuilder, x: str) -> str:
    """Which entries are above 0.3."""
    return g.op("Greater", x, g.constant(0.3, np.float32))


def unreal(g: GraphBuilder, x: str) -> str:
    """NaN where an entry is below 0."""
    return g.op("Sqrt", x)


def square(g: GraphBuilder, x: str) -> str:
    """(1, 1, 3, 3)."""
    return g.op("Slice", x, ints(g, 0, 1), ints(g, 1, 4), ints(g, 1, 3))


# Each takes x (1, 2, 3, 4), uneven numbers about 0, and gives a value of any shape.
OPERATORS: dict[str, Callable[[GraphBuilder, str], str]] = {
    **{
        kind: lambda g, x, kind=kind: g.op(kind, x)
        for kind in (
            "Abs",
            "Cos",
            "Exp",
            "Log",
            "Neg",
            "Reciprocal",
            "Relu",
            "Sigmoid",
            "Sign",
            "Sin",
            "Sqrt",
            "Tanh",
        )
    },
    **{
        f"{kind} in doubles": lambda g, x, kind=kind: g.op(kind, double(g, x))
        for kind in ("Abs", "Cos", "Exp", "Log", "Neg", "Reciprocal", "Sin", "Sqrt", "Tanh")
    },
    **{
        f"{kind} along axis {axis}": lambda g, x, kind=kind, axis=axis: g.op(
            kind, x, ints(g, axis), keepdims=axis % 2
        )
        for kind in ("ReduceMax", "ReduceMean", "ReduceMin", "ReduceSum", "ReduceSumSquare")
        for axis in (1, -2, 3)
    },
    **{
        f"{kind} against a row": lambda g, x, kind=kind: g.op(kind, x, randoms(g, 4))
        for kind in ("Add", "Div", "Max", "Min", "Mul", "Sub")
    },
    **{
        f"{kind} against a column": lambda g, x, kind=kind: truth(g, g.op(kind, x, randoms(g, 3, 1)))
        for kind in ("Greater", "GreaterOrEqual", "Less", "LessOrEqual")
    },
    "Equal": lambda g, x: truth(g, g.op("Equal", g.op("Relu", x), g.constant(0.0, np.float32))),
    "And, Or, Not": lambda g, x: truth(
        g,
        g.op(
            "And",
            g.op("Not", bright(g, x)),
            g.op("Or", bright(g, x), bright(g, g.op("Neg", x))),
        ),
    ),
    "Where": lambda g, x: g.op("Where", bright(g, x), x, randoms(g, 2, 1, 4)),
    "Pow": lambda g, x: g.op("Pow", x, g.constant(3.0, np.float32)),
    "Clip": lambda g, x: g.op("Clip", x, g.constant(-0.2, np.float32), g.constant(0.4, np.float32)),
    "Clip below": lambda g, x: g.op("Clip", x, g.constant(-0.2, np.float32)),
    "Clip above": lambda g, x: g.op("Clip", x, "", g.constant(0.4, np.float32)),
    "Clip of no number": lambda g, x: g.op("Clip", unreal(g, x), g.constant(-0.2, np.float32)),
    "Max of no number": lambda g, x: g.op("Max", unreal(g, x), x),
    "Max with no number": lambda g, x: g.op("Max", x, unreal(g, x)),
    "Sum of three": lambda g, x: g.op("Sum", x, randoms(g, 3, 1), randoms(g, 4)),
    "ReduceSum of all": lambda g, x: g.op("ReduceSum", x),
    "ReduceMean of two axes": lambda g, x: g.op("ReduceMean", double(g, x), ints(g, 1, 3)),
    "Transpose": lambda g, x: g.op("Transpose", x, perm=[0, 3, 1, 2]),
    "Transpose, then Reshape": lambda g, x: g.op(
        "Reshape", g.op("Transpose", x, perm=[0, 3, 1, 2]), ints(g, 6, 4)
    ),
    "Slice backwards": lambda g, x: g.op(
        "Slice", x, ints(g, 3, 1), ints(g, -99, 3), ints(g, 3, 2), ints(g, -2, 1)
    ),
    "Gather a column": lambda g, x: g.op("Gather", x, g.constant(2, np.int64), axis=3),
    "Gather in disorder": lambda g, x: g.op("Gather", x, ints(g, 3, 0, 0, 2, 1), axis=3),
    "Gather at computed places": lambda g, x: g.op("Gather", randoms(g, 2, 5, 3), whole(g, x), axis=1),
    "Gather of what is computed": lambda g, x: g.op(
        "Gather", g.op("Transpose", x, perm=[0, 3, 2, 1]), whole(g, g.op("Reshape", x, ints(g, 24))), axis=-1
    ),
    "GatherND": lambda g, x: g.op(
        "GatherND", g.op("Squeeze", x, ints(g, 0)), g.constant([[1, 0], [0, 2]], np.int64)
    ),
    "Expand": lambda g, x: g.op("Expand", g.op("Unsqueeze", x, ints(g, 2)), ints(g, 1, 2, 5, 3, 4)),
    "Concat": lambda g, x: g.op("Concat", x, randoms(g, 1, 2, 3, 2), x, axis=-1),
    "Flatten": lambda g, x: g.op("Flatten", g.op("Transpose", x, perm=[0, 2, 1, 3]), axis=2),
    "Tile": lambda g, x: g.op("Tile", x, ints(g, 1, 2, 1, 3)),
    "Pad": lambda g, x: g.op("Pad", x, ints(g, 0, 1, 0, 2, 0, 0, 1, 3), g.constant(0.7, np.float32)),
    "MatMul of many": lambda g, x: g.op("MatMul", x, g.op("Transpose", x, perm=[0, 1, 3, 2])),
    "MatMul, one for all": lambda g, x: g.op("MatMul", x, randoms(g, 4, 5)),
    "Gemm": lambda g, x: g.op(
        "Gemm",
        g.op("Reshape", x, ints(g, 4, 6)),
        randoms(g, 5, 4),
        randoms(g, 5),
        transA=1,
        transB=1,
        alpha=0.5,
    ),
    "Einsum": lambda g, x: g.op("Einsum", x, randoms(g, 3, 2, 5), equation="bcij,ick->bjk"),
    "Inverse": lambda g, x: g.op("Inverse", square(g, x), domain=ONNX_RUNTIME),
    "Inverse in doubles": lambda g, x: g.op("Inverse", double(g, square(g, x)), domain=ONNX_RUNTIME),
    "Inverse of what begins with 0": lambda g, x: g.op(
        "Inverse", g.op("Mul", square(g, x), g.constant(1 - np.eye(3), np.float32)), domain=ONNX_RUNTIME
    ),
    "Conv": lambda g, x: g.op(
        "Conv", x, randoms(g, 5, 2, 2, 3), randoms(g, 5), pads=[1, 0, 0, 2], strides=[1, 2], dilations=[2, 1]
    ),
    "Shape": lambda g, x: g.op("Expand", g.op("ReduceSum", x, ints(g, 3)), g.op("Shape", x)),
}


def graph_of(g: GraphBuilder, outputs: dict[str, int | None]) -> bytes:
    """`features` (B, 24) -> values (B, n) by name."""
    graph = onnx.helper.make_graph(
        g.nodes,
        "operators",
        [onnx.helper.make_tensor_value_info("features", TensorProto.FLOAT, ["B", 24])],
        [
            onnx.helper.make_tensor_value_info(name, TensorProto.FLOAT, ["B", n])
            for name, n in outputs.items()
        ],
        g.constants,
    )
    opsets = [onnx.helper.make_opsetid("", OPSET), onnx.helper.make_opsetid(ONNX_RUNTIME, 1)]
    return onnx.helper.make_model(graph, opset_imports=opsets, ir_version=10).SerializeToString()


@pytest.fixture(scope="module")
def of_operators(card: Card, tmp_path_factory: pytest.TempPathFactory) -> dict[str, np.ndarray]:
    """(2, entries) for each operator: C's and ONNX Runtime's, for two inputs, from one graph of them all."""
    g = GraphBuilder()
    x = g.op("Reshape", "features", ints(g, 1, 2, 3, 4))
    parts = [
        g.cast(g.op("Reshape", build(g, x), ints(g, 1, -1)), TensorProto.FLOAT)
        for build in OPERATORS.values()
    ]
    session = ort.InferenceSession(graph_of(g, dict.fromkeys(parts)), providers=["CPUExecutionProvider"])
    x = np.random.default_rng(0).normal(0.0, 1.0, (2, 24)).astype(np.float32)
    rows = [session.run(None, {"features": x[n : n + 1]}) for n in range(2)]
    wanted = np.concatenate([np.hstack(row) for row in rows])
    ends = np.cumsum([part.shape[1] for part in rows[0]])
    graph = graph_of(g, {g.op("Concat", *parts, axis=1): wanted.shape[1]})
    code = Case(onnx.load_model_from_string(graph), {"features": x}).c_rows(
        tmp_path_factory.mktemp("operators"), card
    )
    return {
        name: np.stack([ours, theirs])
        for name, ours, theirs in zip(
            OPERATORS, np.split(code, ends[:-1], 1), np.split(wanted, ends[:-1], 1), strict=True
        )
    }


@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_is_onnx_runtimes(of_operators: dict[str, np.ndarray], name: str) -> None:
    ours, theirs = of_operators[name]
    assert difference(ours, theirs) < 1e-6


UNCOVERED: dict[str, Callable[[GraphBuilder], str]] = {
    "Softmax": lambda g: g.op("Softmax", "features"),
    "Expand": lambda g: g.op("Expand", "features", "features"),
    "Einsum": lambda g: g.op("Einsum", "features", "features", equation="...i,...i->..."),
}


@pytest.mark.parametrize("kind", UNCOVERED)
def test_an_operator_that_has_no_form_is_named(card: Card, kind: str) -> None:
    g = GraphBuilder()
    graph = onnx.load_model_from_string(graph_of(g, {UNCOVERED[kind](g): 24}))
    with pytest.raises(NoForm, match=kind):
        sources(graph, card)


def a_model(name: str) -> Case:
    """A model on windows, its graph as `train` exports it."""
    if name == "cnn":
        return a_network()
    offsets = np.array([-12.0, -9.0, -6.0, -3.0, 3.0, 6.0, 9.0, 12.0])
    slides = labelled_slides(interpolation.DIRECTIONS_DEG, offsets)
    config = {
        "interpolation": InterpolationConfig(),
        "trees": TreesConfig(trees=20),
        "mlp": MlpConfig(members=2, hidden=(16,), iterations=60),
        "gp": GpConfig(search_rows=60),
    }[name]
    features = float_features(slides)
    noise = np.random.default_rng(0).normal(0, 0.1, features.shape).astype(np.float32)
    graph = classical._graph(classical._fit(slides, config), features.shape[1])
    return Case(graph, {"features": np.concatenate([features, features + noise])})


class FewSlides(WindowSource):
    """Sixteen slides, with other noise each time: what a network learns in seconds well enough to stand behind."""

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        slides = super().draw(16, torch.Generator().manual_seed(1))
        volts, *others = (
            v.repeat_interleave(count // len(slides.volts), 0)
            for v in (slides.volts, slides.elapsed_s, slides.weight, slides.targets)
        )
        return WindowBatch(volts + 5e-4 * torch.randn(volts.shape, generator=generator), *others)


def a_network() -> Case:
    """On windows that the network stands behind: elsewhere rounding decides between two minima."""
    torch.set_num_threads(1)
    config = NetworkConfig()
    whole = SynthesisConfig(complete=1.0, paused=0.0, midway=0.0, depth_mm=0.0)
    source = FewSlides(bump_map(), 0.02, whole)
    training = TrainingConfig(steps=300, batch=64, rate=0.01, average=0.9, seed=7)
    network = SlideNetwork(
        train_proposal(source, config, training), Refinement(bump_map(), 0.02, config.refinement)
    ).eval()
    drawn = source.draw(160, torch.Generator().manual_seed(3))
    volts = torch.cat([drawn.volts, torch.zeros_like(drawn.volts[:, :1])], 1)
    inputs = {"volts": volts, "elapsed_s": drawn.elapsed_s, "weight": drawn.weight}
    with torch.no_grad():
        column = dict(zip(OUTPUTS, network(**inputs).T, strict=False))
    stands = (column["misfit"] < 5) & (column["direction_sd_deg"] < 8) & (column["log_speed_sd"] < 0.15)
    assert stands.sum() >= 50
    return Case(export_graph(network, 1), {k: v[stands].numpy() for k, v in inputs.items()})


@pytest.fixture(
    scope="module",
    params=["interpolation", "trees", "mlp", "gp", pytest.param("cnn", marks=pytest.mark.long)],
)
def model(request: pytest.FixtureRequest) -> Case:
    return a_model(request.param)


def test_a_model_computes_the_same(model: Case, card: Card, tmp_path: Path) -> None:
    assert difference(model.c_rows(tmp_path, card), model.onnx_rows()) < 1e-5


def test_a_model_keeps_to_its_memory(model: Case, card: Card, tmp_path: Path) -> None:
    """Under the address and undefined-behaviour sanitizers, which end the process at the first fault."""
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    if subprocess.run(["cc", *SANITIZED, probe, "-o", tmp_path / "probe"], capture_output=True).returncode:
        pytest.skip("this compiler has no sanitizers")
    assert difference(model.c_rows(tmp_path, card, SANITIZED), model.onnx_rows()) < 1e-5


def test_arrays_that_are_alive_together_share_nothing(model: Case) -> None:
    statements = program(model.graph).statements
    offsets, sizes = layout(statements)
    writer = {kind: np.full(size, -1) for kind, size in sizes.items()}
    number: dict[Buffer, int] = {}
    for statement in statements:
        for buffer in (*statement.reads, statement.writes):
            if buffer.scratch:
                held = writer[buffer.kind][offsets[buffer] :][: buffer.size]
                assert len(held) == buffer.size
                if buffer is statement.writes:
                    held[:] = number.setdefault(buffer, len(number))
                assert (held == number[buffer]).all()


def test_export_writes_c_that_works_its_own_example(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor(2), offset_mm_per_v=50.0)
    out = tmp_path / "c"
    assert softslide.main(["export", "--model", str(bundle), "--to", "c", "--out", str(out)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["operators"] == {"Gemm": 1, "output": 1}
    assert told["constants_kb"] == pytest.approx((6 * 64 * 5 + 5) * 4 / 1e3)
    assert told["static_ram_kb"] == pytest.approx(5 * 4 / 1e3)
    assert (out / "model.json").read_bytes() == (bundle / "model.json").read_bytes()
    assert "const float volts[384], float elapsed_s, const float weight[2]" in (out / "model.h").read_text()
    compiled(out, "check")
    assert subprocess.run([out / "check"], capture_output=True, check=False).returncode == 0
    text = (out / "model.c").read_text()
    (out / "model.c").write_text(text.replace("estimate[i0] =", "estimate[i0] = 1.01f *"))
    compiled(out, "check")
    assert subprocess.run([out / "check"], capture_output=True, check=False).returncode != 0


def test_what_has_no_form_in_c_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor())
    graph = onnx.load_model_from_string((bundle / "model.onnx").read_bytes())
    graph.graph.node[1].output[0] = "row"
    graph.graph.node.append(onnx.helper.make_node("Elu", ["row"], ["estimate"]))
    (bundle / "model.onnx").write_bytes(graph.SerializeToString())
    resigned(bundle)
    assert softslide.main(["export", "--model", str(bundle), "--to", "c", "--out", str(tmp_path / "c")]) == 2
    told = capsys.readouterr().err
    assert len(told.splitlines()) == 1
    assert "Elu" in told
    assert not (tmp_path / "c").exists()


def resigned(bundle: Path) -> None:
    """Makes the card fit a graph that was changed."""
    content = (bundle / "model.onnx").read_bytes()
    table = json.loads((bundle / "model.json").read_text())
    inputs = {k: np.array(v, np.float32) for k, v in table["golden"]["inputs"].items()}
    row = ort.InferenceSession(content, providers=["CPUExecutionProvider"]).run(None, inputs)[0][0]
    table["golden"]["estimate"] = row.tolist()
    table["graph_sha256"] = hashlib.sha256(content).hexdigest()
    (bundle / "model.json").write_text(json.dumps(table))

"""Opens a bundle, and checks that card and graph belong together and give the result of the card's example."""

import struct
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from threading import Thread
from typing import TypeVar

import numpy as np
import onnxruntime as ort
from onnxruntime.capi.onnxruntime_pybind11_state import NotImplemented as MissingOperator

from softslide.features.card import Card, read_card
from softslide.features.digest import sha256
from softslide.features.errors import InputError
from softslide.features.height import HEIGHT_INPUT
from softslide.features.regular_file import read_regular
from softslide.features.vector.feature_vector import feature_names
from softslide.features.window import WINDOW_BINS
from softslide.serve.graph_limits import MOST_BYTES, check_onnx
from softslide.serve.ort_limits import check_ort

# Largest difference between two processors' arithmetic, relative or absolute. Graph and original differ by 4e-5
# (experiments/LOG.md); more than 1e-3 is another graph.
GOLDEN_TOLERANCE = 1e-3
# Loading takes a tenth of a second, a window a few ms; what takes longer than this is not a model to localize with.
LOADING_S = 20.0
GRAPHS = {"model.onnx": check_onnx, "model.ort": check_ort}
T = TypeVar("T")
# Of each the runtime needs one.
_NEEDED = (("direction_cos",), ("direction_sin",), ("offset_mm",), ("log_speed", "log_speed_width"))


def open_bundle(bundle: str | Path, unsigned: bool = False) -> tuple[Card, ort.InferenceSession]:
    """The card and a session of its graph, model.onnx or model.ort. unsigned: as in `read_card`.

    Raises:
        InputError: the bundle is missing, altered or truncated, an output is missing or named twice, or it does not
            give the result of its card's example.
    """
    bundle = Path(bundle)
    path = next((bundle / name for name in GRAPHS if (bundle / name).is_file()), bundle / "model.onnx")
    card = read_card(bundle / "model.json", unsigned)
    _check_outputs(card, bundle / "model.json")
    graph = read_regular(path, MOST_BYTES, "a bundle holds model.onnx and model.json")
    if sha256(graph).hexdigest() != card.graph_sha256:
        raise InputError(
            f"{path}: not the graph that model.json describes; take the bundle from its source again"
        )
    return card, _in_time(lambda: _checked_session(card, graph, path), path)


def _check_limits(graph: bytes, path: Path) -> None:
    try:
        GRAPHS[path.name](graph)
    except (ValueError, IndexError, TypeError, AttributeError, struct.error) as error:
        reason = error if type(error) is ValueError else "damaged"
        raise InputError(
            f"{path}: no graph that this release runs ({reason}); take the bundle from its source again"
        ) from None


def _checked_session(card: Card, graph: bytes, path: Path) -> ort.InferenceSession:
    _check_limits(graph, path)
    session = open_session(graph, path)
    _check_shapes(card, session, path)
    _check_golden(card, session, path)
    return session


def open_session(graph: bytes, path: Path) -> ort.InferenceSession:
    """A session with one thread that does not spin: small graphs are slower on several. path: named in errors.

    Raises:
        InputError: ONNX Runtime cannot load the graph: damaged, a newer opset, or unknown operators.
    """
    for level in (ort.GraphOptimizationLevel.ORT_ENABLE_ALL, ort.GraphOptimizationLevel.ORT_ENABLE_BASIC):
        options = ort.SessionOptions()
        options.graph_optimization_level = level
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 4
        try:
            return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        except MissingOperator:
            # Some releases (1.22) fuse products of doubles into an operator that they then lack.
            continue
        except Exception as error:  # ONNX Runtime raises types of its own
            raise InputError(
                f"{path}: no graph that ONNX Runtime can load ({_line(error)}); export again"
            ) from None
    raise InputError(f"{path}: needs an operator that this ONNX Runtime lacks; install a newer one")


def _check_outputs(card: Card, path: Path) -> None:
    missing = [names[0] for names in _NEEDED if not set(names) & set(card.outputs)]
    if missing or len(set(card.outputs)) < len(card.outputs):
        wrong = f"output {missing[0]} is missing" if missing else "an output is named twice"
        raise InputError(f"{path}: {wrong}; export the bundle again")


def _check_shapes(card: Card, session: ort.InferenceSession, path: Path) -> None:
    accelerometers = len(card.channels) // 3
    wanted: dict[str, tuple[int, ...]] = (
        {"volts": (len(card.channels), WINDOW_BINS), "elapsed_s": (), "weight": (accelerometers,)}
        if card.input == "window"
        else {"features": (len(feature_names(accelerometers)),)}
    )
    found = {node.name: node for node in session.get_inputs()}
    if set(found) != set(wanted):
        raise InputError(f"{path}: inputs are {', '.join(found)}, not {', '.join(wanted)}; export again")
    optional = [node.name for node in session.get_overridable_initializers()]
    if card.heights is not None and HEIGHT_INPUT not in optional:
        raise InputError(f"{path}: takes no height of the skin, its card has several; export again")
    outputs = session.get_outputs()
    if [node.name for node in outputs] != ["estimate"]:
        names = ", ".join(node.name for node in outputs)
        raise InputError(f"{path}: outputs are {names}, not estimate; export again")
    found["estimate"], wanted["estimate"] = outputs[0], (len(card.outputs),)
    for name, shape in wanted.items():
        node = found[name]
        fixed = [(n, m) for n, m in zip(node.shape[1:], shape, strict=False) if isinstance(n, int)]
        if node.type != "tensor(float)" or len(node.shape) != 1 + len(shape) or any(n != m for n, m in fixed):
            raise InputError(
                f"{path}: {name} is {node.type} {node.shape}, its card says tensor(float) "
                f"{['batch', *shape]}; export again"
            )


def _check_golden(card: Card, session: ort.InferenceSession, path: Path) -> None:
    try:
        inputs = {k: np.array(v, dtype=np.float32) for k, v in card.golden["inputs"].items()}
        wanted = np.array(card.golden["estimate"], dtype=np.float32)
        row = session.run(None, inputs)[0][0]
    except Exception as error:  # ONNX Runtime raises types of its own
        raise InputError(
            f"{path}: the card's example does not run ({_line(error)}); export the bundle again"
        ) from None
    near = row.shape == wanted.shape and np.allclose(
        row, wanted, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
    )
    if not near:
        raise InputError(f"{path}: the graph does not compute its card's example; export the bundle again")


def _in_time(call: Callable[[], T], path: Path) -> T:
    """What the call returns or raises; after LOADING_S it is left behind, in a thread that ends with the process."""
    outcome: Future[T] = Future()

    def work() -> None:
        try:
            outcome.set_result(call())
        except Exception as error:
            outcome.set_exception(error)

    Thread(target=work, daemon=True).start()
    try:
        return outcome.result(LOADING_S)
    except TimeoutError:
        raise InputError(
            f"{path}: not loaded and run once in {LOADING_S:g} s; take the bundle from its source again"
        ) from None


def _line(error: Exception) -> str:
    """The error in one line; ONNX Runtime's have several."""
    return " ".join(str(error).split())[:160]

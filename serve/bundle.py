"""Opens a bundle, and checks that card and graph belong together and give the result of the card's example."""

import math
from pathlib import Path

import numpy as np
import onnxruntime as ort
from onnxruntime.capi.onnxruntime_pybind11_state import NotImplemented as MissingOperator

from features.card import Card, read_card
from features.errors import InputError
from features.vector.feature_vector import feature_names
from features.window import WINDOW_BINS

try:
    # hashlib loads OpenSSL, 4 MB of memory that nothing else here needs.
    from _sha2 import sha256
except ImportError:
    try:
        from _sha256 import sha256  # Python 3.11
    except ImportError:
        from hashlib import sha256

# Largest difference between two processors' arithmetic, relative or absolute. Graph and original differ by 4e-5
# (experiments/LOG.md); more than 1e-3 is another graph.
GOLDEN_TOLERANCE = 1e-3
GRAPHS = ("model.onnx", "model.ort")
_NEEDED = ("direction_cos", "direction_sin", "offset_mm")


def open_bundle(bundle: Path) -> tuple[Card, ort.InferenceSession]:
    """The card and a session of its graph, model.onnx or model.ort.

    Raises:
        InputError: the bundle is missing, altered or truncated, its channels and its sensor disagree, or it does not
            give the result of its card's example.
    """
    path = next((bundle / name for name in GRAPHS if (bundle / name).is_file()), bundle / GRAPHS[0])
    card = read_card(bundle / "model.json")
    _check_card(card, bundle / "model.json")
    try:
        graph = path.read_bytes()
    except OSError:
        raise InputError(f"{path}: cannot be read; a bundle holds model.onnx and model.json") from None
    if sha256(graph).hexdigest() != card.graph_sha256:
        raise InputError(
            f"{path}: not the graph that model.json describes; take the bundle from its source again"
        )
    session = open_session(graph, path)
    _check_shapes(card, session, path)
    _check_golden(card, session, path)
    return card, session


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


def _check_card(card: Card, path: Path) -> None:
    """Checks of what the runtime relies on, beyond the card's own."""
    accelerometers = card.sensor.get("accelerometers") if isinstance(card.sensor, dict) else None
    if not isinstance(accelerometers, list | tuple):
        raise InputError(f"{path}: sensor names no accelerometers; export the bundle again")
    names = tuple(f"a{n}_{axis}" for n in range(len(accelerometers)) for axis in ("vx", "vy", "vz"))
    if card.channels != names:
        raise InputError(
            f"{path}: channels are {', '.join(map(str, card.channels))}, the sensor's are {', '.join(names)}; "
            "export the bundle again"
        )
    for n, accelerometer in enumerate(accelerometers):
        for key in ("zero_g_v", "sensitivity_v_per_g"):
            if not _number(accelerometer.get(key) if isinstance(accelerometer, dict) else None):
                raise InputError(f"{path}: accelerometer {n} has no {key}; export the bundle again")
    speeds = [name for name in ("log_speed", "log_speed_width") if name in card.outputs]
    missing = [name for name in _NEEDED if name not in card.outputs] or ([] if speeds else ["log_speed"])
    if missing or len(set(card.outputs)) < len(card.outputs):
        wrong = f"output {missing[0]} is missing" if missing else "an output is named twice"
        raise InputError(f"{path}: {wrong}; export the bundle again")
    if not (_number(card.sample_rate_hz) and card.samples_per_block >= 1):
        raise InputError(
            f"{path}: sample_rate_hz {card.sample_rate_hz:g} gives no sample in a block of "
            f"{card.conditioning.block_s:g} s; export the bundle again"
        )
    limits = vars(card.validity).values()
    numbers = [v for limit in limits for v in (limit if isinstance(limit, tuple) else (limit,))]
    numbers += [v for interval in card.intervals.values() for v in vars(interval).values()]
    numbers += card.reference_mm
    if any(isinstance(v, bool) or not isinstance(v, int | float) or math.isnan(v) for v in numbers):
        raise InputError(f"{path}: a limit or an interval is no number; export the bundle again")
    if len(card.reference_mm) != 2 or len(card.validity.speed_mm_s) != 2:
        raise InputError(f"{path}: reference_mm and speed_mm_s are pairs; export the bundle again")


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


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _line(error: Exception) -> str:
    """The error in one line; ONNX Runtime's have several."""
    return " ".join(str(error).split())[:160]

"""Writes a bundle, model.onnx and model.json, and refuses one that does not compute what was trained."""

import hashlib
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime as ort

from softslide.features.base_motion import BaseMotion
from softslide.features.card import BENT, Card, write_card
from softslide.features.errors import CheckFailed
from softslide.features.vector.feature_vector import feature_matrix
from softslide.models.fitted_model import FittedModel
from softslide.models.graph.packing import unpack
from softslide.models.held_out import DEVIATIONS, believed
from softslide.pipeline.recordings.windows import LabelledWindows
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.staging import staged

PARITY = 1e-4  # relative difference of graph and original
# Of what is computed before the last step: rounding of the proposal moves it the most where that step is a long one (of
# three accelerometers the misfit 1.3e-4, of one a deviation at its limit 2e-4, estimates 2e-5; experiments/LOG.md).
BEFORE_LAST_STEP = ("misfit", "strain", "straight", *BENT, *DEVIATIONS.values())
MISFIT_PARITY = 1e-3
DIGITS = 4  # of the card's worked example and of the fit's figures: all digits are 3 kB
AT_LIMIT = 1e-3  # share of windows that one of them may answer and the other not


class ParityError(CheckFailed):
    """The exported graph and the original disagree."""


def graph_inputs(model_input: str, volts: np.ndarray, elapsed_s: np.ndarray) -> dict[str, np.ndarray]:
    """A graph's inputs for windows volts (B, C, 64) V, elapsed_s (B,) s, every accelerometer in use."""
    if model_input == "features":
        return {"features": feature_matrix(volts, elapsed_s).astype(np.float32)}
    weight = np.ones((len(volts), volts.shape[1] // 3), dtype=np.float32)
    return {"volts": volts.astype(np.float32), "elapsed_s": elapsed_s.astype(np.float32), "weight": weight}


def write_bundle(
    fitted: FittedModel,
    sensor: Sensor,
    windows: LabelledWindows,
    provenance: dict[str, Any],
    out: Path,
    base: BaseMotion | None = None,
) -> float:
    """Writes the bundle; returns the largest relative difference of graph and original where the model answers.

    base: what was taken out of the recordings that it was fitted to.

    Raises:
        ParityError: it is more than PARITY, of BEFORE_LAST_STEP more than MISFIT_PARITY; nothing is written.
        InputError: `out` cannot be written.
    """
    graph = fitted.graph.SerializeToString()
    inputs = graph_inputs(fitted.input, windows.volts, windows.elapsed_s)
    session = session_of(graph)
    exported = session.run(None, inputs)[0]
    original = fitted.original(inputs)
    # Where the model abstains (too little of the stroke to distinguish lines), its iteration may end in
    # either of two minima, and rounding decides: such rows are no estimates and nothing to compare.
    stands, also_stands = (believed(rows, fitted.outputs, fitted.validity) for rows in (original, exported))
    if fitted.validity.misfit == 0.0:
        # Too few slides to say what is usual (models/intervals.py): none is believed, the rows are compared still.
        stands = np.isfinite(original).all(axis=1)
    elif np.mean(also_stands != stands) <= AT_LIMIT:
        # Rounding decides on a window at one of the limits.
        stands &= also_stands
    if not stands.any():
        raise ParityError(
            f"the trained {fitted.name} answers none of the windows it was given; nothing was written"
        )
    differences = relative_differences(exported[stands], original[stands]).max(axis=0)
    limit = np.array([MISFIT_PARITY if name in BEFORE_LAST_STEP else PARITY for name in fitted.outputs])
    difference = float(differences.max())
    if not (differences <= limit).all():
        worst = int((differences / limit).argmax())
        raise ParityError(
            f"ONNX Runtime and the trained {fitted.name} differ by {differences[worst]:.1e} relative in "
            f"{fitted.outputs[worst]} (limit {limit[worst]:g}); nothing was written: train with another seed"
        )
    # A whole slide, if there is one, that the model answers: JSON has no NaN.
    golden = int(np.flatnonzero(stands)[windows.stroke_fraction[stands].argmax()])
    example = {k: _short(v[golden : golden + 1].tolist()) for k, v in inputs.items()}
    row = {name: np.array(value, np.float32) for name, value in example.items()}
    card = Card(
        model=fitted.name,
        input=fitted.input,
        outputs=fitted.outputs,
        sensor=asdict(sensor),
        channels=sensor.channels,
        sample_rate_hz=sensor.sample_rate_hz,
        reference_mm=sensor.reference_mm,
        conditioning=fitted.conditioning,
        intervals=fitted.intervals,
        validity=fitted.validity,
        provenance={**provenance, "fit": _short(fitted.summary), "parity": difference},
        golden={"inputs": example, "estimate": session.run(None, row)[0][0].tolist()},
        graph_sha256=hashlib.sha256(graph).hexdigest(),
        contact=fitted.contact,
        force=fitted.force,
        heights=fitted.heights,
        base=base,
    )
    with staged(out) as folder:
        (folder / "model.onnx").write_bytes(graph)
        write_card(card, folder / "model.json")
    return difference


def _short(values: Any) -> Any:
    """Numbers of nested lists and tables to DIGITS."""
    if isinstance(values, dict):
        return {key: _short(value) for key, value in values.items()}
    return [_short(value) for value in values] if isinstance(values, list) else float(f"{values:.{DIGITS}g}")


def session_of(graph: bytes) -> ort.InferenceSession:
    """A session of a graph that was just made. It does not warn of an input that need not be given."""
    options = ort.SessionOptions()
    options.log_severity_level = 3
    return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])


def with_graph(card: Card, graph: bytes) -> Card:
    """The card of another graph: its hash, and its own row for the worked example."""
    inputs = {name: np.array(value, np.float32) for name, value in card.golden["inputs"].items()}
    row = session_of(graph).run(None, inputs)[0][0]
    golden = {**card.golden, "estimate": row.tolist()}
    return replace(card, golden=golden, graph_sha256=hashlib.sha256(graph).hexdigest())


def read_graph(bundle: Path) -> onnx.ModelProto:
    """The graph of a bundle, its constants in single precision."""
    graph = onnx.load_model_from_string((bundle / "model.onnx").read_bytes())
    unpack(graph)
    return graph


def relative_differences(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(n, K): |a - b| over the column's largest |b|; infinite where only one is NaN."""
    torn = np.isnan(a) != np.isnan(b)
    a, b = np.nan_to_num(a), np.nan_to_num(b)
    return np.where(torn, np.inf, np.abs(a - b) / np.maximum(np.abs(b).max(axis=0), 1e-6))

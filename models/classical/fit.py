"""The classical models as `softslide train` makes them: fitted, their intervals judged on held-out lines, exported."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import onnx

from features.angles import wrapped_deg
from features.card import Interval, Validity
from features.errors import InputError
from features.stream.conditioning import Conditioning
from features.vector.energy import energy_width_s
from features.vector.feature_vector import feature_names
from models.classical import baselines, interpolation
from models.classical.axis_interpolation import fit_interpolation
from models.classical.baseline_graphs import gp_graph, mlp_graph, trees_graph
from models.classical.baselines import float_features, taught
from models.classical.interpolation import SPEED_FORMS
from models.fitted_model import FittedModel
from models.held_out import line_folds
from models.intervals import conformal_interval
from pipeline.recordings.folder import Folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows

FOLDS = 5


class OnFeatures(Protocol):
    """Anything that turns features (n, F) into rows (n, K)."""

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K)."""


@dataclass(frozen=True)
class InterpolationConfig:
    """form: of the speed's polynomial, "reciprocal" (v = a / t + b) or "quadratic", the published one."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    form: str = "reciprocal"

    def __post_init__(self) -> None:
        if self.form not in SPEED_FORMS:
            raise ValueError(f"form is '{self.form}'; choose one of {', '.join(SPEED_FORMS)}")


@dataclass(frozen=True)
class TreesConfig:
    """trees: in each of the three forests. least_leaf: windows in a leaf at least; fewer make the graph larger."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    trees: int = 150
    least_leaf: int = 6
    seed: int = 0


@dataclass(frozen=True)
class MlpConfig:
    """members: networks averaged. hidden: their layers. penalty: of squared weights. iterations: passes."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    members: int = 3
    hidden: tuple[int, ...] = (64, 64)
    penalty: float = 0.03
    iterations: int = 150
    seed: int = 0


@dataclass(frozen=True)
class GpConfig:
    """search_rows: windows that choose the kernels' constants. least_noise: variance, of the target's."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    search_rows: int = 400
    least_noise: float = 1e-5
    seed: int = 0


ClassicalConfig = InterpolationConfig | TreesConfig | MlpConfig | GpConfig
CONFIGS: dict[str, Callable[[], ClassicalConfig]] = {
    "interpolation": InterpolationConfig,
    "trees": TreesConfig,
    "mlp": MlpConfig,
    "gp": GpConfig,
}


def fit_classical(name: str, folder: Folder, config: ClassicalConfig) -> FittedModel:
    """Fits one of CONFIGS to the folder's labelled slides.

    Raises:
        InputError: nothing to fit it to, or a sensor that it is not made for.
    """
    if not len(folder):
        raise InputError(f"{folder.root}: {name} needs labelled recordings; only cnn trains without")
    boards = len(folder.sensor.accelerometers)
    if name == "interpolation" and boards > 1:
        raise InputError(
            f"the interpolation reads one accelerometer, {folder.sensor.name} has {boards}; use cnn"
        )
    windows = labelled_windows(folder, config.conditioning)
    model = _fit(windows, config)
    outputs = interpolation.OUTPUTS if isinstance(config, InterpolationConfig) else baselines.OUTPUTS
    intervals, summary = _judge(windows, config, outputs)
    reach = float(np.abs(windows.offset_mm).max()) + 1.5
    return FittedModel(
        name=name,
        input="features",
        outputs=outputs,
        graph=_graph(model, len(feature_names(boards))),
        original=lambda inputs: model.predict(inputs["features"]),
        intervals=intervals,
        validity=Validity(offset_mm=reach),
        conditioning=config.conditioning,
        summary=summary,
    )


def _fit(windows: LabelledWindows, config: ClassicalConfig) -> OnFeatures:
    match config:
        case InterpolationConfig():
            return fit_interpolation(windows, config.form)
        case TreesConfig():
            return baselines.fit_trees(windows, config.trees, config.least_leaf, config.seed)
        case MlpConfig():
            return baselines.fit_mlp(
                windows, config.members, config.hidden, config.penalty, config.iterations, config.seed
            )
        case GpConfig():
            return baselines.fit_gp(windows, config.search_rows, config.least_noise, config.seed)


def _graph(model: OnFeatures, features: int) -> onnx.ModelProto:
    match model:
        case interpolation.Interpolation():
            return model.onnx()
        case baselines.Trees():
            return trees_graph(model, features)
        case baselines.Perceptrons():
            return mlp_graph(model, features)
        case baselines.GaussianProcess():
            return gp_graph(model, features)
    raise TypeError(f"no graph for {type(model).__name__}")


def _judge(
    windows: LabelledWindows, config: ClassicalConfig, outputs: tuple[str, ...]
) -> tuple[dict[str, Interval], dict[str, float]]:
    """Intervals and mean errors on lines that the fit has not seen; none where there are too few lines."""
    fold = line_folds(windows.direction_deg, windows.offset_mm, FOLDS)
    rows = np.full((len(windows), len(outputs)), np.nan)
    for k in range(FOLDS):
        seen, unseen = windows[fold != k], fold == k
        if len(taught(seen)) and unseen.any():
            rows[unseen] = _fit(seen, config).predict(float_features(windows[unseen]))
    known = np.isfinite(rows).all(axis=1) & (windows.stroke_fraction >= baselines.EARLIEST)
    if known.sum() < 20:
        return {}, {}
    errors = _errors(rows[known], windows[known], outputs)
    whole = windows.stroke_fraction[known] > 0.99
    slide = windows.recording[known]
    intervals = {name: conformal_interval(e, np.zeros(len(e)), slide) for name, e in errors.items()}
    means = {f"heldout_{name}": float(np.abs(e[whole]).mean()) for name, e in errors.items() if whole.any()}
    return intervals, means


def _errors(rows: np.ndarray, windows: LabelledWindows, outputs: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Signed errors (n,): direction deg, log speed, offset mm."""
    column = dict(zip(outputs, rows.T, strict=True))
    direction = np.degrees(np.arctan2(column["direction_sin"], column["direction_cos"]))
    if "log_speed" in column:
        log_speed = column["log_speed"]
    else:
        log_speed = column["log_speed_width"] - np.log(energy_width_s(windows.volts, windows.elapsed_s))
    return {
        "direction_deg": -wrapped_deg(windows.direction_deg - direction),
        "log_speed": log_speed - np.log(windows.speed_mm_s),
        "offset_mm": column["offset_mm"] - windows.offset_mm,
    }

"""From a model on features to one that `softslide train` makes: fitted, judged on held-out lines, with its graph."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import onnx

from softslide.features.card import COVERAGE, Interval, Validity
from softslide.features.errors import InputError
from softslide.features.vector.feature_vector import feature_names
from softslide.models.classical.learned_lines import LearnedLines, SharesConfig, learned_windows
from softslide.models.classical.misfit import Misfit
from softslide.models.classical.regression import EARLIEST, float_features, late_windows
from softslide.models.fitted_model import FittedModel, Given, Model
from softslide.models.graph.builder import GraphBuilder
from softslide.models.held_out import mean_errors, offset_reach_mm, signed_errors
from softslide.models.intervals import LEAST_WINDOWS, conformal_interval, misfit_limit, step_between
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import LabelledWindows

RECORDED_ALONE = SharesConfig(recorded_share=1.0)


class OnFeatures(Protocol):
    """A fitted model from features to rows of `outputs`."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the K columns."""

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K) of features (n, F)."""

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """The same in nodes of a graph, in float64: rows (B, K) of features (B, F) float32."""


Fit = Callable[[LabelledWindows, Any], OnFeatures]


@dataclass(frozen=True)
class WithMisfit:
    """A model on features, its rows followed by the misfit of the features that they are made of."""

    model: OnFeatures
    misfit: Misfit

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the K + 1 columns."""
        return (*self.model.outputs, "misfit")

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K + 1) of features (n, F)."""
        return np.column_stack([self.model.predict(features), self.misfit(features)])

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """`predict` in nodes."""
        return g.op("Concat", self.model.nodes(g, features), self.misfit.nodes(g, features), axis=1)


def graph_of(model: OnFeatures, features: int) -> onnx.ModelProto:
    """The model's graph: `features` (B, F) float32 -> `estimate` (B, K) float32."""
    g = GraphBuilder()
    return g.model(model.nodes(g, "features"), features, len(model.outputs))


def feature_model(config: Callable[[], Any], fit: Fit) -> Model:
    """The registry's entry for a model on features.

    config: its configuration's dataclass, with a field `conditioning`, and `training` where drawn windows are to stand
    next to recorded ones (learned_lines.py). fit: windows and configuration -> the model.
    """

    def fitted(folder: Folder, settings: Any, given: Given) -> FittedModel:
        boards = len(folder.sensor.accelerometers)
        if not len(folder):
            raise InputError(f"{folder.root}: no labelled recordings; record some, or train cnn without")
        shares = getattr(settings, "training", RECORDED_ALONE)
        learned = learned_windows(folder, settings.conditioning, shares, given.atlas, given.calibrate)
        model = WithMisfit(fit(learned.whole, settings), Misfit.of(learned.whole))
        intervals, limit, summary = _judge(learned, settings, fit, model.outputs)
        return FittedModel(
            input="features",
            outputs=model.outputs,
            graph=graph_of(model, len(feature_names(boards))),
            original=lambda inputs: model.predict(inputs["features"]),
            intervals=intervals,
            validity=Validity(offset_mm=offset_reach_mm(learned.recorded), misfit=limit),
            conditioning=learned.conditioning,
            summary=learned.summary | summary,
            windows=learned.recorded,
            contact=learned.contact,
            untimed=learned.untimed,
            left_out=learned.left_out,
        )

    return Model(config, fitted, uses_design=hasattr(config(), "training"))


def _judge(
    learned: LearnedLines, settings: Any, fit: Fit, outputs: tuple[str, ...]
) -> tuple[dict[str, Interval], float, dict[str, float]]:
    """Intervals, the largest misfit of a valid estimate, and mean errors, on lines that the fit has not seen.

    No intervals, and a limit that nothing meets, where there are too few lines.
    """
    windows = learned.recorded
    rows = np.full((len(windows), len(outputs)), np.nan)
    for seen, unseen in learned.folds:
        if len(late_windows(seen)) and unseen.any():
            model = WithMisfit(fit(seen, settings), Misfit.of(seen))
            rows[unseen] = model.predict(float_features(windows[unseen]))
    known = np.isfinite(rows).all(axis=1) & (windows.stroke_fraction >= EARLIEST)
    if known.sum() < LEAST_WINDOWS:
        return {}, 0.0, {}
    windows, rows = windows[known], rows[known]
    errors = signed_errors(rows, outputs, windows)
    labels = {
        "direction_deg": windows.direction_deg,
        "log_speed": np.log(windows.speed_mm_s),
        "offset_mm": windows.offset_mm,
    }
    intervals = {}
    for name, error in errors.items():
        step = step_between(labels[name] + error, 360.0 if name == "direction_deg" else None)
        least = COVERAGE * step / 2
        intervals[name] = conformal_interval(error, np.zeros(len(error)), windows.recording, least=least)
    limit = misfit_limit(rows[:, -1], windows.recording)
    return intervals, limit, {f"heldout_{k}": mean for k, mean in mean_errors(errors, windows).items()}

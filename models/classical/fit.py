"""From a model on features to one that `softslide train` makes: fitted, judged on held-out lines, with its graph."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
import onnx

from features.card import Interval, Validity
from features.errors import InputError
from features.vector.feature_vector import feature_names
from models.classical.regression import EARLIEST, float_features, late_windows
from models.fitted_model import FittedModel, Model
from models.held_out import line_folds, mean_errors, offset_reach_mm, signed_errors
from models.intervals import conformal_interval
from pipeline.recordings.folder import Folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows

FOLDS = 5
LEAST_WINDOWS = 20  # to set intervals on: with fewer a 90 % quantile is the largest error


class OnFeatures(Protocol):
    """A fitted model from features to rows of `outputs`."""

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the K columns."""

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K) of features (n, F)."""

    def graph(self, features: int) -> onnx.ModelProto:
        """The same as a graph: `features` (B, F) float32 -> `estimate` (B, K) float32."""


Fit = Callable[[LabelledWindows, Any], OnFeatures]


def feature_model(config: Callable[[], Any], fit: Fit) -> Model:
    """The registry's entry for a model on features.

    config: its configuration's dataclass, with a field `conditioning`. fit: windows and configuration -> the model.
    """

    def fitted(folder: Folder, settings: Any) -> FittedModel:
        boards = len(folder.sensor.accelerometers)
        if not len(folder):
            raise InputError(f"{folder.root}: no labelled recordings; record some, or train cnn without")
        windows = labelled_windows(folder, settings.conditioning)
        model = fit(windows, settings)
        intervals, summary = _judge(windows, settings, fit, model.outputs)
        return FittedModel(
            name="",
            input="features",
            outputs=model.outputs,
            graph=model.graph(len(feature_names(boards))),
            original=lambda inputs: model.predict(inputs["features"]),
            intervals=intervals,
            validity=Validity(offset_mm=offset_reach_mm(windows)),
            conditioning=settings.conditioning,
            summary=summary,
            left_out={
                str(name): "no output reaches the trigger"
                for name in folder.manifest.index
                if name not in windows.recording
            },
        )

    return Model(config, fitted)


def _judge(
    windows: LabelledWindows, settings: Any, fit: Fit, outputs: tuple[str, ...]
) -> tuple[dict[str, Interval], dict[str, float]]:
    """Intervals and mean errors on lines that the fit has not seen; none where there are too few lines."""
    fold = line_folds(windows.direction_deg, windows.offset_mm, FOLDS)
    rows = np.full((len(windows), len(outputs)), np.nan)
    for k in range(FOLDS):
        seen, unseen = windows[fold != k], fold == k
        if len(late_windows(seen)) and unseen.any():
            rows[unseen] = fit(seen, settings).predict(float_features(windows[unseen]))
    known = np.isfinite(rows).all(axis=1) & (windows.stroke_fraction >= EARLIEST)
    if known.sum() < LEAST_WINDOWS:
        return {}, {}
    windows = windows[known]
    errors = signed_errors(rows[known], outputs, windows)
    intervals = {k: conformal_interval(e, np.zeros(len(e)), windows.recording) for k, e in errors.items()}
    return intervals, {f"heldout_{k}": mean for k, mean in mean_errors(errors, windows).items()}

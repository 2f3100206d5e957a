"""scikit-learn estimators for users' own pipelines: the feature vector, and the article's interpolation.

A row of X is one window, flattened: the bins of V_x, V_y and V_z of each accelerometer in V, then its length in s.
The distance of the sample's slides by ridge regression on the features:

>>> from sklearn.linear_model import Ridge
>>> from sklearn.pipeline import make_pipeline
>>> from sklearn.preprocessing import StandardScaler
>>> from models.classical.sklearn_api import WindowFeatures, flat_windows
>>> from pipeline.recordings.folder import SAMPLE, read_folder
>>> from pipeline.recordings.windows import labelled_windows
>>> windows = labelled_windows(read_folder(SAMPLE).select("calibration"), fractions=(1.0,))
>>> X, y = flat_windows(windows.volts, windows.elapsed_s), abs(windows.offset_mm)
>>> model = make_pipeline(WindowFeatures(), StandardScaler(), Ridge(10.0)).fit(X, y)
>>> bool(model.score(X, y) > 0.9)
True

`AxisInterpolation("distance")` stands in the place of this pipeline just so.
"""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from softslide.features.vector.feature_vector import feature_matrix, feature_names
from softslide.features.window import WINDOW_BINS
from softslide.models.classical.interpolation import (
    SPEED_FORMS,
    abscissas,
    degree,
    evaluate_polynomials,
    fit_polynomials,
    slide_direction,
)

QUANTITIES = ("speed", "distance")
NARROW = ("refuse", "pad")


def flat_windows(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
    """Rows (n, C 64 + 1) of windows volts (n, C, 64) V and elapsed_s (n,) s."""
    return np.column_stack([volts.reshape(len(volts), -1), elapsed_s])


def split_rows(rows: np.ndarray, accelerometers: int, narrow: str) -> tuple[np.ndarray, np.ndarray]:
    """volts (n, C, 64) V and elapsed_s (n,) s of flat rows; the inverse of `flat_windows`.

    narrow: what to do with rows that lack columns: "refuse", or "pad" with channels that read zero, as a
    recording without V_z has them. The last column is the length in either case.

    Raises:
        ValueError: rows too narrow to accept or too wide for that many accelerometers.
    """
    if narrow not in NARROW:
        raise ValueError(f"narrow is {narrow!r}; choose one of {', '.join(NARROW)}")
    if accelerometers < 1:
        raise ValueError(f"accelerometers is {accelerometers}; a sensor has at least one")
    bins = 3 * accelerometers * WINDOW_BINS
    missing = bins + 1 - rows.shape[1]
    if missing < 0 or (missing and narrow == "refuse"):
        raise ValueError(
            f"X has {rows.shape[1]} columns; windows of {accelerometers} accelerometer(s) have {bins + 1}: "
            f"{WINDOW_BINS} bins of V_x, V_y and V_z each, and the length in s"
        )
    volts = np.pad(rows[:, :-1], ((0, 0), (0, missing)))
    return volts.reshape(len(rows), 3 * accelerometers, WINDOW_BINS), rows[:, -1]


class WindowFeatures(TransformerMixin, BaseEstimator):
    """Flat windows (n, C 64 + 1) -> features (n, F); stateless but for the shape it was fitted to.

    accelerometers: how many there are in a row. narrow: see `split_rows`.
    """

    def __init__(self, accelerometers: int = 1, narrow: str = "refuse") -> None:
        self.accelerometers = accelerometers
        self.narrow = narrow

    def fit(self, X: Any, y: Any = None) -> "WindowFeatures":
        """Notes the width of X."""
        rows = validate_data(self, X, dtype=np.float64)
        split_rows(rows[:1], self.accelerometers, self.narrow)
        return self

    def transform(self, X: Any) -> np.ndarray:
        """Features (n, F) in `features.vector.feature_vector.feature_names` order."""
        check_is_fitted(self, "n_features_in_")
        rows = validate_data(self, X, dtype=np.float64, reset=False)
        return feature_matrix(*split_rows(rows, self.accelerometers, self.narrow))

    def get_feature_names_out(self, input_features: Any = None) -> np.ndarray:
        """Names of the features, with their units."""
        check_is_fitted(self, "n_features_in_")
        return np.array(feature_names(self.accelerometers), dtype=object)


class AxisInterpolation(RegressorMixin, BaseEstimator):
    """Flat windows (n, 193) -> speed or distance (n,), for one accelerometer.

    quantity: "speed" or "distance" (its magnitude). form: "quadratic" or "reciprocal", of the speed's polynomial.
    undefined: what to predict where the method is not defined (no axis slide, no extreme passed yet): "mean",
    the targets' mean, as scores and searches need a number; or "nan".
    narrow: see `split_rows`.
    """

    def __init__(
        self,
        quantity: str = "speed",
        form: str = "reciprocal",
        undefined: str = "mean",
        narrow: str = "refuse",
    ) -> None:
        self.quantity = quantity
        self.form = form
        self.undefined = undefined
        self.narrow = narrow

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        # Defined on slides along an axis alone; other data get the mean.
        tags.regressor_tags.poor_score = True
        return tags

    def fit(self, X: Any, y: Any) -> "AxisInterpolation":
        """Fits one polynomial for each direction and extreme; the direction is the zones'."""
        for name, choices in (
            ("quantity", QUANTITIES),
            ("form", SPEED_FORMS),
            ("undefined", ("mean", "nan")),
        ):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} is {getattr(self, name)!r}; choose one of {', '.join(choices)}")
        rows, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        features = feature_matrix(*split_rows(rows, 1, self.narrow))
        abscissa, passed = abscissas(features, self.quantity, self.form)
        usable = passed & slide_direction(features)[:, :, None]
        self.coefficients_ = fit_polynomials(
            abscissa, usable, target, degree(self.quantity, self.form), np.ones(len(target))
        )
        self.mean_ = float(target.mean())
        return self

    def predict(self, X: Any) -> np.ndarray:
        """The quantity (n,) in the targets' unit."""
        check_is_fitted(self, "coefficients_")
        rows = validate_data(self, X, dtype=np.float64, reset=False)
        features = feature_matrix(*split_rows(rows, 1, self.narrow))
        each = evaluate_polynomials(self.coefficients_, *abscissas(features, self.quantity, self.form))
        direction = slide_direction(features)
        value = np.where(direction, each, 0.0).sum(axis=1)
        defined = direction.any(axis=1) & np.isfinite(value)
        return np.where(defined, value, self.mean_ if self.undefined == "mean" else np.nan)

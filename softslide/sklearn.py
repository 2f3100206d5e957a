"""scikit-learn estimators for users' own pipelines: features, a regression on them, the article's interpolation.

A row of X is one window, flattened: the bins of V_x, V_y and V_z of each accelerometer in V, then its length in s.
The distance of the sample's slides by ridge regression on the features:

>>> from sklearn.linear_model import Ridge
>>> from sklearn.pipeline import make_pipeline
>>> from sklearn.preprocessing import StandardScaler
>>> from softslide.pipeline.recordings.folder import SAMPLE, read_folder
>>> from softslide.pipeline.recordings.windows import labelled_windows
>>> from softslide.sklearn import SlideRegressor, WindowFeatures, flat_windows
>>> windows = labelled_windows(read_folder(SAMPLE).select("calibration"), fractions=(1.0,))
>>> X, y = flat_windows(windows.volts, windows.elapsed_s), abs(windows.offset_mm)
>>> model = make_pipeline(WindowFeatures(), StandardScaler(), Ridge(10.0)).fit(X, y)
>>> bool(model.score(X, y) > 0.9)
True

`AxisInterpolation("distance")` stands in the place of this pipeline just so, and `SlideRegressor` for any direction:

>>> speeds = windows.speed_mm_s
>>> bool(SlideRegressor("speed").fit(X, speeds).score(X, speeds) > 0.9)
True
"""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin, TransformerMixin, clone
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from softslide.features.vector.energy import energy_width_s
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
from softslide.models.classical.regression import read_columns

QUANTITIES = ("speed", "distance")
SLIDE_QUANTITIES = ("direction", "speed", "offset")
NARROW = ("refuse", "pad")
LEAST_WIDTH_S = 1e-3  # of a window that shows nothing


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


class SlideRegressor(RegressorMixin, BaseEstimator):
    """Flat windows (n, C 64 + 1) -> direction (deg, 0 to 360), speed (mm/s) or offset (mm) of a slide, (n,).

    What is regressed on the features that hold no seconds is cosine and sine of the direction, the offset, or
    log(v sigma_t): speed times energy width in time is a length that the line alone decides, so that a fit knows any
    speed. quantity: "direction", "speed" or "offset". regressor: of several outputs; None: extremely randomized trees.
    accelerometers: how many there are in a row. narrow: see `split_rows`.
    """

    def __init__(
        self,
        quantity: str = "speed",
        regressor: Any = None,
        accelerometers: int = 1,
        narrow: str = "refuse",
    ) -> None:
        self.quantity = quantity
        self.regressor = regressor
        self.accelerometers = accelerometers
        self.narrow = narrow

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.positive_only = self.quantity == "speed"
        # Tables that are no windows have no width to measure a speed by.
        tags.regressor_tags.poor_score = True
        return tags

    def fit(self, X: Any, y: Any) -> "SlideRegressor":
        """Fits a copy of the regressor. y: (n,) in the quantity's unit."""
        if self.quantity not in SLIDE_QUANTITIES:
            raise ValueError(f"quantity is {self.quantity!r}; choose one of {', '.join(SLIDE_QUANTITIES)}")
        rows, target = validate_data(self, X, y, dtype=np.float64, y_numeric=True)
        if self.quantity == "speed" and (target <= 0.0).any():
            raise ValueError("y holds speeds that are not above 0")
        features, width_s = self._features(rows)
        if self.quantity == "direction":
            angle = np.deg2rad(target)
            target = np.column_stack([np.cos(angle), np.sin(angle)])
        elif self.quantity == "speed":
            target = np.log(target * width_s)
        trees = ExtraTreesRegressor(60, min_samples_leaf=min(6, 1 + len(rows) // 20), random_state=0)
        self.regressor_ = clone(trees if self.regressor is None else self.regressor).fit(features, target)
        return self

    def predict(self, X: Any) -> np.ndarray:
        """The quantity (n,)."""
        check_is_fitted(self, "regressor_")
        features, width_s = self._features(validate_data(self, X, dtype=np.float64, reset=False))
        found = self.regressor_.predict(features)
        if self.quantity == "direction":
            return np.rad2deg(np.arctan2(found[:, 1], found[:, 0])) % 360.0
        return np.exp(found) / width_s if self.quantity == "speed" else found

    def _features(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What the regressor reads (n, F), and the energy's width (n,) s."""
        volts, elapsed_s = split_rows(rows, self.accelerometers, self.narrow)
        width_s = np.maximum(energy_width_s(volts, np.abs(elapsed_s)), LEAST_WIDTH_S)
        return feature_matrix(volts, elapsed_s)[:, read_columns(self.accelerometers)], width_s


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

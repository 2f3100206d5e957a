"""The article's interpolation fitted: to labelled windows, and one quantity at a time as a scikit-learn regressor."""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from features.angles import wrapped_deg
from features.errors import InputError
from features.vector.feature_vector import feature_matrix, feature_names
from models.classical.interpolation import (
    DETECTABLE_MM,
    DIRECTIONS_DEG,
    SPEED_FORMS,
    Interpolation,
    abscissas,
    degree,
    evaluate_polynomials,
    fit_polynomials,
    slide_direction,
)
from models.classical.sklearn_api import split_rows
from pipeline.recordings.windows import LabelledWindows

QUANTITIES = ("speed", "distance")
_CENTRE_S = feature_names(1).index("energy_centre_s")
_UNDER_WAY = 0.75
# A slide this close to an axis counts as along it, deg.
_AXIS_DEG = 1.0


def fit_interpolation(windows: LabelledWindows, form: str = "reciprocal") -> Interpolation:
    """Fits to the whole axis slides in the detectable area, one set of polynomials a direction.

    The reciprocal form minimizes relative errors of the speed; the published one is a plain polynomial fit.

    Raises:
        InputError: no whole slides along an axis.
    """
    turned = np.abs(wrapped_deg(windows.direction_deg[:, None] - DIRECTIONS_DEG))
    axis = (turned < _AXIS_DEG) & (np.abs(windows.offset_mm)[:, None] <= DETECTABLE_MM)
    whole = windows.stroke_fraction >= windows.stroke_fraction.max()
    rows = axis.any(axis=1) & whole
    if not rows.any():
        raise InputError("the interpolation needs slides along x or y, over the whole stroke; record some")
    features = feature_matrix(windows.volts, windows.elapsed_s).astype(np.float32).astype(np.float64)
    speed = windows.speed_mm_s
    polynomials = {}
    for quantity, target, weight in (
        ("speed", speed, 1.0 / speed if form == "reciprocal" else np.ones(len(speed))),
        ("distance", np.abs(windows.offset_mm), np.ones(len(speed))),
    ):
        abscissa, passed = abscissas(features[rows], quantity, form)
        usable = passed & axis[rows][:, :, None]
        polynomials[quantity] = fit_polynomials(
            abscissa, usable, target[rows], degree(quantity, form), weight[rows]
        )
    start_mm = np.array([_start_mm(windows[axis[:, k]], features[axis[:, k]]) for k in range(4)])
    return Interpolation(form, polynomials["speed"], polynomials["distance"], start_mm)


def _start_mm(windows: LabelledWindows, features: np.ndarray) -> float:
    """Where along its line a slide triggers, mm from the foot of the perpendicular; NaN if no slide says."""
    start = windows.along_mm - windows.speed_mm_s * windows.elapsed_s
    # A slide that is over stands still while its label moves on.
    under_way = (windows.stroke_fraction < _UNDER_WAY) & np.isfinite(start)
    if under_way.any():
        return float(np.median(start[under_way]))
    # Without a record of the motion: the energy is centred near the foot, where the contact is nearest.
    return float(np.median(-windows.speed_mm_s * features[:, _CENTRE_S])) if len(windows) else np.nan


class AxisInterpolation(RegressorMixin, BaseEstimator):
    """Flat windows (n, 193) -> speed or distance (n,), for one accelerometer.

    quantity: "speed" or "distance" (its magnitude). form: "quadratic" or "reciprocal", of the speed's polynomial.
    undefined: what to predict where the method is not defined (no axis slide, no extreme passed yet): "mean",
    the targets' mean, as scores and searches need a number; or "nan".
    narrow: see `models.classical.sklearn_api.split_rows`.
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

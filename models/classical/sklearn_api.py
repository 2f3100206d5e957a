"""The feature vector as a scikit-learn transformer, to stand at the head of a pipeline.

A row of X is one window, flattened: the bins of V_x, V_y and V_z of each accelerometer in V, then its length in s.
"""

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from features.vector.feature_vector import feature_matrix, feature_names
from features.window import WINDOW_BINS

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

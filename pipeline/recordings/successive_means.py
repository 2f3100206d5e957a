"""Means of samples, so many at a time."""

import numpy as np


def successive_means(values: np.ndarray, count: int) -> np.ndarray:
    """(m, ...) means of `count` values each of (n, ...), one after the other; what is left over is not used."""
    whole = len(values) // count
    return values[: whole * count].reshape(whole, count, *values.shape[1:]).mean(axis=1)

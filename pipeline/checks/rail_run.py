"""Clipping: an output that stays at its highest or lowest reading."""

import numpy as np

MOST_AT_RAIL = 5  # equal samples; an output that is not clipped seldom has its extreme twice in a row


def rail_run(column: np.ndarray) -> int:
    """The longest run of samples equal to the highest or the lowest reading; 0 if all are equal."""
    if column.min() == column.max():
        return 0
    longest = 0
    for rail in (column.min(), column.max()):
        at = np.flatnonzero(column == rail)
        breaks = np.flatnonzero(np.diff(at) > 1)
        edges = np.concatenate([[-1], breaks, [len(at) - 1]])
        longest = max(longest, int(np.diff(edges).max()))
    return longest

"""Clipping: an output that stays at its highest or lowest reading."""

import numpy as np

MOST_AT_RAIL = 5  # equal samples; an output that is not clipped seldom has its extreme twice in a row
# A smooth peak that is read in steps is on the step below its top for sqrt(2) - 1 of the time at the top at least, as a
# parabola whose peak is at the top's edge; one that is clipped comes to the rail and leaves it steeply.
LEAST_BELOW = 0.1


def rail_run(column: np.ndarray) -> int:
    """The longest run of samples equal to the highest or the lowest reading, where it is none of a smooth peak's; 0 if
    there is none, or all are equal."""
    readings = np.unique(column)
    if len(readings) < 2:
        return 0
    return max(_longest(column, *readings[:2]), _longest(column, *readings[:-3:-1]))


def _longest(column: np.ndarray, rail: float, below: float) -> int:
    """The longest run at a rail that is longer than a smooth peak's. below: the reading next to it."""
    begins, ends = _runs(column == rail)
    near = _runs((column == rail) | (column == below))
    # Each run lies within one of those that are at the rail or next to it.
    within = np.searchsorted(near[0], begins, "right") - 1
    at_rail, next_to_it = ends - begins, (near[1] - near[0])[within]
    clipped = at_rail * (1 + LEAST_BELOW) > next_to_it
    return int(at_rail[clipped].max(initial=0))


def _runs(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each run of True begins, and the sample after its end."""
    edges = np.diff(np.concatenate([[0], mask.astype(np.int8), [0]]))
    return np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)

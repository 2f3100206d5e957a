"""Slides between recorded lines, made from the features of their neighbours.

Trees answer with averages of what they were fitted to, so between two lines they step from one to the other. Features
and targets change nearly linearly from a line to the next one, and rows in between turn the step into a ramp.
"""

from itertools import pairwise

import numpy as np

from softslide.pipeline.recordings.windows import LabelledWindows

# Lines farther apart than this are no neighbours, mm: the outputs' extremes bend in between.
NEIGHBOUR_MM = 5.1
SHARES = (0.25, 0.5, 0.75)
# Directions closer than this are one, deg.
_SAME_DEG = 0.5


def with_lines_between(
    windows: LabelledWindows, features: np.ndarray, targets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """features (n, F) and targets (n, K) with rows added: (1 - w) a + w b for each two neighbours a, b.

    Neighbours are windows of slides along adjacent lines in one direction, read at the same share of the stroke.
    """
    a, b = _neighbours(windows)
    rows, goals = [features], [targets]
    for share in SHARES:
        rows.append((1.0 - share) * features[a] + share * features[b])
        goals.append((1.0 - share) * targets[a] + share * targets[b])
    return np.concatenate(rows).astype(features.dtype), np.concatenate(goals)


def _neighbours(windows: LabelledWindows) -> tuple[np.ndarray, np.ndarray]:
    """Index pairs (m,), (m,)."""
    group = np.stack(
        [np.round(windows.direction_deg / _SAME_DEG) * _SAME_DEG % 360.0, windows.stroke_fraction], axis=1
    )
    _, member = np.unique(group, axis=0, return_inverse=True)
    pairs: list[tuple[int, int]] = []
    for k in range(int(member.max(initial=-1)) + 1):
        rows = np.flatnonzero(np.ravel(member) == k)
        lines = np.unique(windows.offset_mm[rows])
        for near, far in pairwise(lines):
            if far - near <= NEIGHBOUR_MM:
                here, there = (rows[windows.offset_mm[rows] == line] for line in (near, far))
                pairs += [(i, j) for i in here for j in there]
    first, second = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    return first, second

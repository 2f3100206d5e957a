"""Paths over a grid: straight lines in the 16 lattice directions, circles and S-curves.

Places are (n, 2) mm. A line of the direction (i, j) is numbered by q = j x - i y, x and y counted in steps of the grid.
Lines with even q are for presses of the even places of the checkerboard, lines with odd q for the odd places: what is
learned on the one colour and tested on the other shares neither a press nor a line.
"""

from dataclasses import dataclass

import numpy as np

DIRECTIONS = tuple(
    (si * i, sj * j)
    for i, j in ((1, 0), (0, 1), (1, 1), (2, 1), (1, 2))
    for si in ((1, -1) if i else (1,))
    for sj in ((1, -1) if j else (1,))
)
# Shorter lines cut a corner: half the side of the grid is what a line has at least.
LEAST_SHARE = 0.5
CURVE_POINTS = 2000  # of which a curve is made: 0.03 mm apart on the longest


@dataclass(frozen=True)
class GridPath:
    """corners: (n, 2) mm, of a polygon; two of a straight line."""

    corners: np.ndarray

    @property
    def length_mm(self) -> float:
        """Along the path."""
        return float(np.hypot(*np.diff(self.corners, axis=0).T).sum())

    def at(self, way_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Place (n, 2) mm and direction (n, 2) at distances (n,) mm along it."""
        leg = np.diff(self.corners, axis=0)
        length = np.hypot(*leg.T)
        ends = np.append(0.0, np.cumsum(length))
        place = np.stack([np.interp(way_mm, ends, self.corners[:, k]) for k in range(2)], axis=1)
        n = np.clip(np.searchsorted(ends, way_mm, side="right") - 1, 0, len(leg) - 1)
        return place, leg[n] / length[n, None]


def lines(x_mm: np.ndarray, y_mm: np.ndarray, colour: str) -> list[GridPath]:
    """Every line of every lattice direction across the grid, from its first place to its last."""
    found = []
    size, step = (len(x_mm), len(y_mm)), x_mm[1] - x_mm[0]
    for i, j in DIRECTIONS:
        for x, y in np.ndindex(size):
            if 0 <= x - i < size[0] and 0 <= y - j < size[1]:
                continue  # not the line's first place
            if colour != "any" and (j * x - i * y) % 2 != (colour == "odd"):
                continue
            axes = zip(size, (x, y), (i, j), strict=True)
            count = min((places - 1 - at if d > 0 else at) // abs(d) for places, at, d in axes if d)
            if count * np.hypot(i, j) >= LEAST_SHARE * (min(size) - 1):
                first = np.array([x_mm[x], y_mm[y]])
                found.append(GridPath(np.stack([first, first + count * step * np.array([i, j])])))
    return found


def curve(kind: str, x_mm: np.ndarray, y_mm: np.ndarray, draw: np.random.Generator) -> GridPath:
    """A circle (turned through once) or an S-curve (a period of a sine) that stays within the grid."""
    middle = np.array([x_mm[0] + x_mm[-1], y_mm[0] + y_mm[-1]]) / 2
    half = min(np.ptp(x_mm), np.ptp(y_mm)) / 2
    t = np.linspace(0.0, 1.0, CURVE_POINTS)
    turn = draw.uniform(0, 2 * np.pi)
    if kind == "circles":
        radius = draw.uniform(0.3, 0.7) * half
        angle = turn + draw.choice([-1, 1]) * 2 * np.pi * t
        corners = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        middle = middle + draw.uniform(-1, 1, 2) * (half - radius)
    else:
        reach, height = draw.uniform(0.7, 0.85) * half, draw.choice([-1, 1]) * draw.uniform(0.2, 0.5) * half
        s = np.stack([reach * (2 * t - 1), height * np.sin(2 * np.pi * t)], axis=1)
        corners = s @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return GridPath(middle + corners)

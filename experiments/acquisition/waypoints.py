"""Where a stage carries the ball, over time: waypoints, the moments at which it was at them, and the truth of both.

Waypoints are rows (n, 4) of s, mm, mm and mm: time from the beginning, x and y from the chamber's middle, depth below
the flat skin's face (negative: above it). Between two rows the ball moves evenly; where two have one place it rests.
"""

from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.acquisition.gcode import ends
from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.text_table import numbers, read_text_table
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.paths.partial_contact import touch_depth_mm
from softslide.pipeline.synthesis.paths.response import TRUTH_HZ

COLUMNS = ("time_s", "x_mm", "y_mm", "depth_mm")
# Between waypoints of a drawn path: at 8 mm/s on a radius of 12 mm the chord is 0.03 mm off, a ramp or a kink 0.3 mm.
STEP_S = 0.2
RAMP_POINTS = 9  # of a ramp: the chords of its parabola are 0.1 % of the way off


def waypoints_of(slide: pd.Series) -> np.ndarray:
    """Of a row of a plan: those it names, or of a straight slide its two ends."""
    if slide["waypoints"] is not None:
        return slide["waypoints"]
    start, end = ends(slide)
    depth = slide["depth_mm"]
    return np.array([(0.0, *start, depth), (slide["travel_mm"] / slide["speed_mm_s"], *end, depth)])


def of_path(path: ContactPath) -> np.ndarray:
    """Of a drawn path: every STEP_S, and where it begins or ends to rest or to change its way up or down."""
    time_s, knot, _ = path.knots()
    upright = np.diff(knot) == 0
    edges = time_s[np.append(upright, False) | np.append(False, upright)]
    even = np.arange(time_s[0], time_s[-1], STEP_S)
    even = even[~upright[np.searchsorted(time_s, even, side="right") - 1]]
    # Not so near to an edge that the move between the two would be none.
    even = even[(np.abs(even[:, None] - np.append(edges, time_s[-1])) > STEP_S / 4).all(axis=1)]
    at_s = np.unique(np.concatenate([even, edges, time_s[[0, -1]]]))
    moments = path.at(at_s)
    return np.column_stack([at_s - at_s[0], moments.place_mm, moments.depth_mm]).round(4)


def read_waypoints(path: Path) -> np.ndarray:
    """Reads a CSV of COLUMNS; further ones are left alone.

    Raises:
        InputError: no such file, a column or a number is missing, or time does not go on from 0.
    """
    table = read_text_table(path, "name the file of waypoints, next to the plan")
    if absent := [name for name in COLUMNS if name not in table]:
        raise InputError(f"{path}: column '{absent[0]}' is missing; add it")
    rows = np.column_stack([numbers(table[name]) for name in COLUMNS])
    if (bad := ~np.isfinite(rows).all(axis=1)).any():
        raise InputError(f"{path}: row {bad.argmax() + 1}, a cell is not a finite number; write one")
    if len(rows) < 2 or rows[0, 0] != 0:
        raise InputError(f"{path}: at least two waypoints are needed, the first at time_s 0")
    if (bad := np.diff(rows[:, 0]) <= 0).any():
        raise InputError(f"{path}: row {bad.argmax() + 2}, time_s does not go on; order the rows")
    return rows


def write_waypoints(path: Path, waypoints: np.ndarray) -> None:
    """Writes what `read_waypoints` reads."""
    pd.DataFrame(waypoints, columns=list(COLUMNS)).to_csv(path, index=False, lineterminator="\n")


def stretches(waypoints: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of each stretch of motion; between two of them the ball rests."""
    moves = np.concatenate([[False], (np.diff(waypoints[:, 1:], axis=0) != 0).any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(moves.astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def speeds_mm_s(waypoints: np.ndarray) -> np.ndarray:
    """(n - 1,) of the ball between two waypoints."""
    steps = np.diff(waypoints, axis=0)
    return np.linalg.norm(steps[:, 1:], axis=1) / steps[:, 0]


def ramped(begin_s: float, end_s: float, ramps_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How a stage that has to gain its speed goes through a stretch of waypoints: (m,) s of theirs, and of its own.

    ramps_s: (2,) it takes to the speed of the stretch's begin, and from that of its end. Half of each is lost. A
    stretch that is too short for them is taken as even.
    """
    up, down = ramps_s if ramps_s.sum() < 2 * (end_s - begin_s) else (0.0, 0.0)
    share = np.linspace(0.0, 1.0, RAMP_POINTS)
    own_s = np.concatenate([begin_s + up / 2 * share**2, end_s - down / 2 * (1 - share) ** 2])
    takes_s = end_s - begin_s + (up + down) / 2
    return own_s, np.concatenate([up * share, takes_s - down * (1 - share)])


def truth_of(waypoints: np.ndarray, moments_s: np.ndarray, until_s: float, atlas: Atlas) -> pd.DataFrame:
    """What was so up to a moment of the recording, as `pipeline.recordings.truth` says.

    moments_s: (m, 2) s of the waypoints' time and of the recording's. Contact is deeper than the touch of the atlas's
    untouched skin, of the atlas's median height.
    """
    height_mm = float(np.median(atlas.height_mm))
    time_s = np.arange(int(until_s * TRUTH_HZ) + 1) / TRUTH_HZ
    own_s = np.interp(time_s, moments_s[:, 1], moments_s[:, 0])
    x, y, depth = (np.interp(own_s, waypoints[:, 0], column) for column in waypoints[:, 1:].T)
    return pd.DataFrame(
        {
            "time_s": time_s,
            "x_mm": x,
            "y_mm": y,
            "vx_mm_s": np.gradient(x, time_s),
            "vy_mm_s": np.gradient(y, time_s),
            "contact": (depth > touch_depth_mm(x, y, height_mm, atlas)).astype(int),
            "depth_mm": depth,
        }
    )

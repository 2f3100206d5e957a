"""The article's bounds: read from `bounds.toml`, and held against scored predictions."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.scoring import ESTIMATES, QUANTITIES, near_deg
from softslide.experiments.pages.page import number
from softslide.pipeline.toml_tables import from_table, read_toml

BOUNDS = Path(__file__).parent / "bounds.toml"
PATHS = "track"  # splits of contacts along any path begin with this
ANY = (0.0, float("inf"))
# Labels that a bound's conditions are judged by; the second, of one that holds on the way.
NEEDED = ("direction_deg", "offset_mm")
NEEDED_ON_THE_WAY = (*NEEDED, "start_x_mm", "start_y_mm", "travel_mm", "motion_start_s", "motion_end_s")
AXIS_DEG = 180.0  # after which a line has the same direction again
# A verdict in a word, by `Verdict.met`.
WORDS = {True: "met", False: "missed", None: "not tested"}
# The article's stroke over the inflated area, section 5.3.
INFLATED_MM = 50.0


@dataclass(frozen=True)
class Bound:
    """One promise of the article, and the slides it is made for; the keys are explained in `bounds.toml`."""

    name: str
    quantity: str
    limit: float
    says: str
    source: str
    x_offset_mm: tuple[float, float] | None = None
    y_offset_mm: tuple[float, float] | None = None
    speed_mm_s: tuple[float, float] = ANY
    depth_off_mm: float = float("inf")
    after_travel_mm: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise ValueError(f"quantity is '{self.quantity}'; known are {', '.join(QUANTITIES)}")
        if not self.limit > 0:
            raise ValueError(f"limit is {self.limit}; it must be positive")
        if self.x_offset_mm is None and self.y_offset_mm is None:
            raise ValueError("neither x_offset_mm nor y_offset_mm is given; it would hold for no slide")

    def area_mm(self, direction_deg: float) -> tuple[float, float] | None:
        """Distances of the lines in a direction that it holds for; None: for no line in it."""
        for axis, area in ((0.0, self.x_offset_mm), (90.0, self.y_offset_mm)):
            if near_deg(direction_deg, axis, AXIS_DEG):
                return area
        return None


@dataclass(frozen=True)
class Verdict:
    """A bound held against recordings. Errors in the quantity's unit; `worst` names the recording of the largest.

    met: None where the bound is not tested, and `untested` says why. missing: rows within the conditions that hold no
    valid estimate; one is enough to miss the bound, since the article promises an estimate there. silent: the first
    recording with such a row.
    """

    bound: Bound
    met: bool | None
    recordings: int
    missing: int
    mean: float | None
    max: float | None
    worst: str | None
    silent: str | None
    untested: str | None = None

    def line(self) -> str:
        """The verdict in one line, with the largest error and its recording."""
        head = f"{self.bound.name}, below {self.bound.limit:g} {QUANTITIES[self.bound.quantity]}:"
        if self.met is None:
            return f"{head} not tested, {self.untested}"
        verdict = "met" if self.met else "MISSED"
        largest = "" if self.max is None else f", {number(self.max)} at most ({self.worst})"
        gaps = f", {self.missing} without a valid estimate (first: {self.silent})" if self.missing else ""
        return f"{head} {verdict}{largest} in {self.recordings} recordings{gaps}"

    def as_json(self) -> dict[str, Any]:
        """The verdict for `metrics.json`."""
        bound = {name: getattr(self.bound, name) for name in ("name", "says", "source", "quantity", "limit")}
        named = ("mean", "worst", "recordings", "missing", "silent", "untested")
        found = {name: getattr(self, name) for name in named}
        unit = QUANTITIES[self.bound.quantity]
        return bound | {"unit": unit, "measured": self.max, "pass": self.met} | found


@dataclass(frozen=True)
class _Bounds:
    """The file: a [[bound]] each."""

    bound: tuple[Bound, ...]


def read_bounds(path: Path = BOUNDS) -> tuple[Bound, ...]:
    """Reads the bounds.

    Raises:
        InputError: an unknown or missing key, or a value out of range.
    """
    return from_table(_Bounds, read_toml(path), str(path)).bound


def check(bound: Bound, scored: pd.DataFrame, depths_mm: Sequence[float] = ()) -> Verdict:
    """Holds one bound against the rows of `scoring.score` that meet its conditions.

    depths_mm: contact depths that the sensor is calibrated at; empty: not known, no slide is left out for its depth.
    """
    rows = scored[_within(bound, scored, depths_mm)]
    errors = rows[f"{bound.quantity}_error"]
    absent = errors.isna()
    missing, none = int(absent.sum()), bool(absent.all())
    untested = _untested(bound, scored, rows)
    return Verdict(
        bound,
        met=None if untested else missing == 0 and bool((errors < bound.limit).all()),
        recordings=rows["recording"].nunique(),
        missing=missing,
        mean=None if none else float(errors.mean()),
        max=None if none else float(errors.max()),
        worst=None if none else str(rows["recording"].iloc[int(errors.argmax())]),
        silent=str(rows.loc[absent, "recording"].iloc[0]) if missing else None,
        untested=untested,
    )


def _untested(bound: Bound, scored: pd.DataFrame, rows: pd.DataFrame) -> str | None:
    """Why nothing tests the bound: the model never estimates its quantity, or no recording meets its conditions, of
    which some may lack the labels; None where it is tested. rows: of `scored`, those that meet the conditions."""
    answered = scored[scored["direction_deg"].notna()]
    if len(answered) and answered[ESTIMATES[bound.quantity]].isna().all():
        return "this model does not estimate it"
    if len(rows):
        return None
    each = scored[~scored["split"].str.startswith(PATHS)].drop_duplicates("recording")
    lacking = {
        name: int(each[f"true_{name}"].isna().sum())
        for name in (NEEDED, NEEDED_ON_THE_WAY)[bool(bound.after_travel_mm)]
    }
    gaps = [f"{name} is missing in {count}" for name, count in lacking.items() if count]
    return "no such recording" + (
        f": of {len(each)}, {', '.join(gaps)}" if gaps else "; 'plan' can add tests for it"
    )


def _within(bound: Bound, scored: pd.DataFrame, depths_mm: Sequence[float]) -> pd.Series:
    """Which rows meet the bound's conditions, as booleans."""
    distance = scored["true_offset_mm"].abs()
    # The article's bounds are of straight slides; the labels of another path do not describe it.
    straight = ~scored["split"].str.startswith(PATHS)
    on_lines = pd.Series(False, index=scored.index)
    for axis, area in ((0, bound.x_offset_mm), (90, bound.y_offset_mm)):
        if area is not None:
            along = near_deg(scored["true_direction_deg"], axis, AXIS_DEG)
            on_lines |= along & distance.between(*area) & straight
    speed, depth = scored["true_speed_mm_s"], scored["true_depth_mm"]
    on_lines &= speed.isna() | speed.between(*bound.speed_mm_s)
    if depths_mm:
        off = np.abs(depth.to_numpy(float)[:, None] - np.asarray(depths_mm)).min(axis=1)
        on_lines &= depth.isna() | (off <= bound.depth_off_mm)
    if not bound.after_travel_mm:
        return on_lines & (scored["stroke_fraction"] == 1.0)
    travelled = pd.Series(False, index=scored.index)
    for heading, delay in bound.after_travel_mm.items():
        near = near_deg(scored["true_direction_deg"], float(heading))
        travelled |= near & scored["travelled_mm"].between(delay, INFLATED_MM)
    return on_lines & travelled

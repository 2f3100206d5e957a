"""Errors and bounds against numbers worked out by hand; a bound that cannot fail would be no bound."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from trial_folder import LABELS, SENSOR

from softslide.experiments.evaluation.bounds import Bound, check, read_bounds
from softslide.experiments.evaluation.efficiency import over_bound
from softslide.experiments.evaluation.readout import COLUMNS
from softslide.experiments.evaluation.scoring import (
    along_the_stroke,
    by_direction,
    by_distance,
    by_speed,
    score,
    signed_errors,
    summary,
)
from softslide.features.errors import InputError

# X forward along y = 10: starts 4 mm outside the chamber.
SLIDE = LABELS | {
    "file": "slides/s.parquet",
    "split": "test",
    "speed_mm_s": 2.0,
    "offset_mm": 10.0,
    "start_y_mm": 10.0,
}
# Where a ball of 6 mm, 0.5 mm deep, leaves the rim.
LEFT_MM = 25.0 + math.sqrt(3.0**2 - 2.5**2)


def a_manifest(**rows: dict) -> pd.DataFrame:
    return pd.DataFrame({name: SLIDE | row for name, row in rows.items()}).T.astype(
        dict.fromkeys(LABELS, float)
    )


def predicted(
    recording: str = "s", fraction: float = 1.0, valid: bool = True, **values: float
) -> pd.DataFrame:
    """One row of predictions: exactly right for SLIDE unless given otherwise."""
    right = {
        "direction_deg": 0.0,
        "direction_lo_deg": -1.0,
        "direction_hi_deg": 1.0,
        "speed_mm_s": 2.0,
        "speed_lo_mm_s": 1.9,
        "speed_hi_mm_s": 2.1,
        "offset_mm": 10.0,
        "offset_lo_mm": 9.0,
        "offset_hi_mm": 11.0,
        "x_mm": min(-29.0 + 58.0 * fraction, LEFT_MM),
        "y_mm": 10.0,
    }
    row = {"recording": recording, "stroke_fraction": fraction, "valid": valid, **right, **values}
    return pd.DataFrame([row], columns=list(COLUMNS))


def scored(*predictions: pd.DataFrame, **rows: dict) -> pd.DataFrame:
    table = pd.concat(predictions, ignore_index=True)
    return score(table, a_manifest(**(rows or {"s": {}})), SENSOR)


def test_signed_errors_are_estimate_minus_label() -> None:
    """Of directions the shorter way round."""
    table = pd.DataFrame(
        {
            "direction_deg": [359.0, 1.0, 180.0, 181.0],
            "true_direction_deg": [1.0, 359.0, 0.0, 0.0],
            "speed_mm_s": [2.0 * math.e, 1.0, 2.0, 2.0],
            "true_speed_mm_s": 2.0,
            "offset_mm": [-1.0, 4.0, 1.0, 1.0],
            "true_offset_mm": 1.0,
        }
    )
    errors = signed_errors(table)
    assert errors["direction_deg"].tolist() == [-2.0, 2.0, -180.0, -179.0]
    assert errors["log_speed"].tolist() == pytest.approx([1.0, -math.log(2.0), 0.0, 0.0])
    assert errors["offset_mm"].tolist() == [-2.0, 3.0, 0.0, 0.0]


@pytest.mark.parametrize("direction_deg", [0.0, 30.0, 90.0, 115.0, 200.0, 340.0])
@pytest.mark.parametrize("fraction", [0.5, 0.9])
def test_a_position_error_is_split_into_along_and_across_the_motion(
    direction_deg: float, fraction: float
) -> None:
    """In every direction: the right place has no error, a place 3 mm ahead on the line is off along it alone, a place
    3 mm off it across alone."""
    angle = math.radians(direction_deg)
    along, across = (math.cos(angle), math.sin(angle)), (-math.sin(angle), math.cos(angle))
    offset_mm, travel_mm, moved_mm = 6.0, 58.0, 3.0
    start = [-29.0 * a + offset_mm * b for a, b in zip(along, across, strict=True)]
    slide = {"direction_deg": direction_deg, "offset_mm": offset_mm, "travel_mm": travel_mm}
    slide |= {"start_x_mm": start[0], "start_y_mm": start[1]}
    there = [s + fraction * travel_mm * a for s, a in zip(start, along, strict=True)]

    def errors(shift: tuple[float, float]) -> tuple[float, float, float]:
        x, y = (t + moved_mm * s for t, s in zip(there, shift, strict=True))
        row = scored(predicted(fraction=fraction, x_mm=x, y_mm=y), s=slide).iloc[0]
        return row["position_mm_error"], row["position_percent_error"], row["travelled_mm"]

    assert errors((0.0, 0.0))[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    distance, percent, travelled = errors(along)
    assert (distance, percent) == pytest.approx((moved_mm, 100 * moved_mm / travelled))
    distance, percent, _ = errors(across)
    assert (distance, percent) == pytest.approx((moved_mm, 100 * moved_mm / offset_mm))


def test_a_wrong_answer_has_the_errors_worked_out_by_hand() -> None:
    wrong = scored(
        predicted(direction_deg=357.0, speed_mm_s=2.1, offset_mm=9.0, x_mm=LEFT_MM + 3.0, y_mm=6.0)
    ).iloc[0]
    assert wrong["direction_deg_error"] == 3.0
    assert wrong["speed_percent_error"] == pytest.approx(5.0)
    assert wrong["offset_mm_error"] == 1.0
    assert wrong["offset_percent_error"] == 10.0
    assert wrong["position_mm_error"] == pytest.approx(5.0)  # 3 along, 4 across
    # The chamber begins 4 mm after the start: 54 travelled, 3 / 54 along and 4 / 10 across.
    assert wrong["travelled_mm"] == 54.0
    assert wrong["position_percent_error"] == pytest.approx(40.0)


def test_an_object_that_has_left_the_skin_is_where_it_left() -> None:
    """At the end of the stroke it is 4 mm beyond the rim; an estimate that goes on with it is as far off."""
    assert scored(predicted(x_mm=29.0)).iloc[0]["position_mm_error"] == pytest.approx(29.0 - LEFT_MM)
    unknown_depth = scored(predicted(x_mm=25.0), s={"depth_mm": math.nan})
    assert unknown_depth.iloc[0]["position_mm_error"] == 0.0


def test_a_slide_that_starts_inside_or_runs_diagonally_enters_the_chamber_where_it_does() -> None:
    inside = scored(predicted(fraction=0.5), s={"start_x_mm": -20.0})
    assert inside["travelled_mm"].iloc[0] == 29.0 - 5.0 + 10.0  # the edge lies 5 mm behind the start
    slant = {"direction_deg": 45.0, "start_x_mm": -30.0, "start_y_mm": -30.0, "travel_mm": 60.0}
    assert scored(predicted(), s=slant)["travelled_mm"].iloc[0] == pytest.approx(60.0 - 5.0 * math.sqrt(2.0))
    outside = scored(predicted(), s={"start_y_mm": 26.0})
    assert math.isnan(outside["travelled_mm"].iloc[0])


@pytest.mark.parametrize(
    ("interval", "inside", "outside"),
    [
        ((-5.0, 5.0), 2.0, 6.0),
        ((355.0, 365.0), 2.0, 6.0),
        ((355.0, 5.0), 2.0, 6.0),
        ((10.0, 20.0), 15.0, 5.0),
    ],
)
def test_an_interval_across_zero_degrees_holds_what_lies_in_it(
    interval: tuple[float, float], inside: float, outside: float
) -> None:
    low, high = interval
    for truth, holds in ((inside, 1), (outside, 0)):
        table = scored(predicted(direction_lo_deg=low, direction_hi_deg=high), s={"direction_deg": truth})
        assert table["direction_deg_covered"].tolist() == [holds]
    whole = scored(predicted(direction_lo_deg=-200.0, direction_hi_deg=200.0), s={"direction_deg": outside})
    assert whole["direction_deg_covered"].tolist() == [1]


def test_what_is_not_valid_is_no_estimate() -> None:
    table = scored(predicted(valid=False), predicted("t", speed_mm_s=2.2, speed_lo_mm_s=2.05), s={}, t={})
    result = summary(table)
    assert result["recordings"] == 2
    assert result["valid_share"] == 0.5
    assert result["speed_percent"]["n"] == 1
    assert result["speed_percent"]["max"] == pytest.approx(10.0)
    assert result["speed_percent"]["worst"] == "t"
    assert result["speed_mm_s_coverage"] == {"n": 1, "share": 0.0}


def test_a_summary_is_mean_percentile_and_maximum() -> None:
    offsets = np.arange(1, 102)
    names = [f"r{n}" for n in offsets]
    rows = [predicted(name, offset_mm=10.0 + n / 10) for name, n in zip(names, offsets, strict=True)]
    error = summary(scored(*rows, **{name: {} for name in names}))["offset_mm"]
    assert error == pytest.approx({"n": 101, "mean": 5.1, "p95": 9.6, "max": 10.1, "worst": "r101"}, abs=1e-9)


def test_groups_are_the_articles() -> None:
    headings = {"xf": 359.5, "yf": 90.4, "xb": 180.0, "yb": 270.0, "d": 45.0, "e": 300.0}
    known = {"offset_mm": -3.0, "speed_mm_s": 9.0}
    rows = {name: known | {"direction_deg": angle} for name, angle in headings.items()}
    table = scored(*(predicted(name) for name in rows), **rows)
    assert list(by_direction(table)) == [
        *("X forward", "Y forward", "X backward", "Y backward"),
        *("0 to 90 deg", "270 to 360 deg"),
    ]
    assert list(by_distance(table)) == ["2.5 to 5 mm"]
    assert list(by_speed(table)) == ["8 to 13 mm/s"]
    assert list(along_the_stroke(table)) == ["1.0"]


def bound(name: str) -> Bound:
    return next(b for b in read_bounds() if b.name == name)


@pytest.mark.parametrize(
    ("name", "within", "beyond"),
    [
        ("direction", {"direction_deg": 316.0}, {"direction_deg": 314.0}),
        ("speed", {"speed_mm_s": 2.158}, {"speed_mm_s": 2.162}),
        ("distance", {"offset_mm": 11.49}, {"offset_mm": 8.49}),
        ("position", {"y_mm": 11.49}, {"y_mm": 8.49}),
    ],
)
def test_a_bound_is_met_just_within_it_and_missed_just_beyond(name: str, within: dict, beyond: dict) -> None:
    # At half the stroke X forward has passed the article's delay, and is still on the inflated area.
    fraction = 0.5 if name == "position" else 1.0
    assert check(bound(name), scored(predicted(fraction=fraction, **within))).met is True
    verdict = check(bound(name), scored(predicted(fraction=fraction, **beyond)))
    assert verdict.met is False
    assert verdict.worst == "s"


@pytest.mark.parametrize(
    ("name", "slide"),
    [
        ("speed", {"offset_mm": 18.0}),
        ("speed", {"direction_deg": 20.0}),
        ("speed", {"speed_mm_s": 5.0}),
        ("speed", {"depth_mm": 0.9}),
        ("speed, fast", {"speed_mm_s": 14.0}),
        ("distance", {"offset_mm": 4.9}),
        ("distance", {"direction_deg": 90.0, "offset_mm": 9.9}),
        ("distance, close by", {"direction_deg": 90.0, "offset_mm": 3.0}),
        ("position", {"direction_deg": 180.0, "travel_mm": 24.0}),
        ("direction", {"split": "track-curve"}),
    ],
)
def test_a_slide_outside_a_bounds_conditions_does_not_test_it(name: str, slide: dict) -> None:
    table = scored(predicted(speed_mm_s=0.1, offset_mm=99.0), s=slide)
    assert check(bound(name), table, (0.5,)).met is None


@pytest.mark.parametrize(
    ("depth_mm", "depths_mm", "met"),
    [
        (0.8, (0.8,), True),
        (0.8, (0.3, 0.8), True),
        (0.8, (0.5,), None),
        (0.8, (), True),
        (math.nan, (0.5,), True),
    ],
)
def test_a_bound_holds_at_a_calibrated_depth(
    depth_mm: float, depths_mm: tuple[float, ...], met: bool | None
) -> None:
    """A label that was not given excludes nothing."""
    assert check(bound("speed"), scored(predicted(), s={"depth_mm": depth_mm}), depths_mm).met is met


def test_a_missing_estimate_misses_the_bound() -> None:
    verdict = check(bound("speed"), scored(predicted(), predicted("t", valid=False), s={}, t={}))
    assert (verdict.met, verdict.missing, verdict.worst, verdict.silent) == (False, 1, "s", "t")
    assert "at most (s)" in verdict.line()
    assert "1 without a valid estimate (first: t)" in verdict.line()


def test_what_a_model_never_estimates_is_not_tested_but_one_that_says_nothing_misses() -> None:
    nan = math.nan
    silent = check(bound("position"), scored(predicted(fraction=0.5, x_mm=nan, y_mm=nan)))
    assert silent.met is None
    assert "does not estimate it" in silent.line()
    nothing = predicted(fraction=0.5, x_mm=nan, y_mm=nan, direction_deg=nan, speed_mm_s=nan, valid=False)
    assert check(bound("position"), scored(nothing)).met is False


def test_every_bound_names_its_place_in_the_article() -> None:
    bounds = read_bounds()
    assert len({b.name for b in bounds}) == len(bounds) >= 6
    assert all("section 5." in b.source for b in bounds)


@pytest.mark.parametrize("line", ["limitt = 8", "limit = -1", "quantity = 'warmth'", ""])
def test_a_broken_bound_is_refused(tmp_path: Path, line: str) -> None:
    path = tmp_path / "bounds.toml"
    path.write_text(f"[[bound]]\nname = 'b'\n{line}\n")
    with pytest.raises(InputError, match=r"bounds\.toml"):
        read_bounds(path)


def test_a_bound_for_no_slide_is_refused() -> None:
    with pytest.raises(ValueError, match="no slide"):
        replace(bound("speed"), x_offset_mm=None, y_offset_mm=None)


def test_errors_over_their_bound_by_hand() -> None:
    """Ratios of root mean squares over what is valid, at a fraction that is not quite 0.3."""
    names = ["a", "b", "c", "d"]
    table = pd.DataFrame(
        {
            "recording": names,
            "split": "test",
            "stroke_fraction": 0.1 + 0.2,
            "valid": [True, True, True, False],
            "direction_deg": [359.0, 3.0, 92.0, 0.0],
            "true_direction_deg": [0.0, 0.0, 90.0, 90.0],
            "speed_mm_s": [math.exp(0.01), math.exp(0.01), math.exp(-0.01), 9.0],
            "true_speed_mm_s": 1.0,
            "offset_mm": [0.2, -1.2, -6.2, 0.0],
            "true_offset_mm": [0.0, -1.0, -6.0, 0.0],
        }
    )
    least = pd.DataFrame(
        {"recording": names, "stroke_fraction": 0.3, "direction_deg_bound": [1.0, 1.0, 4.0, 1.0]}
    )
    found = over_bound(table, least.assign(log_speed_bound=0.01, offset_mm_bound=0.1))
    direction = float(f"{math.sqrt((1 + 9 + 4) / (1 + 1 + 16)):.4g}")
    ratios = {"direction_deg": direction, "log_speed": 1.0, "offset_mm": 2.0}
    assert found == {"test": {"0.3": {"recordings": 3, **ratios}}}

"""Tables of errors, as `macros.html.j2` shows them: texts by row, group of columns and column."""

from collections.abc import Mapping
from typing import Any

from softslide.experiments.evaluation import tracks
from softslide.experiments.evaluation.scoring import INTERVALS, QUANTITIES, WORDS
from softslide.experiments.pages.page import number, percent

# A text, or a text and what shows when the pointer rests on it.
Cell = str | tuple[str, str]
Row = dict[str, dict[str, Cell]]
SHOWN = WORDS | {"position_mm": "position"}


def error_table(groups: Mapping[str, Mapping[str, Any]]) -> dict[str, Row]:
    """groups: `scoring.summary` by name."""
    return {name: _errors(row) for name, row in groups.items()}


def _errors(row: Mapping[str, Any]) -> Row:
    cells: Row = {"": {"recordings": str(row["recordings"]), "valid": percent(row["valid_share"])}}
    for quantity, word in SHOWN.items():
        mean, p95, largest = (number(row[quantity].get(kind)) for kind in ("mean", "p95", "max"))
        shown: dict[str, Cell] = {"mean": mean, "p95": p95, "max": (largest, row[quantity].get("worst", ""))}
        cells[f"{word}, {QUANTITIES[quantity]}"] = shown
    held = zip(WORDS.values(), INTERVALS, strict=True)
    return cells | {
        "90 % interval holds": {
            word: percent(row[f"{column}_coverage"].get("share")) for word, column in held
        }
    }


def track_table(splits: Mapping[str, Mapping[str, Any]]) -> dict[str, Row]:
    """splits: `tracks.summarize` by name."""
    return {split: _track(row) for split, row in splits.items()}


def _track(row: Mapping[str, Any]) -> Row:
    shares = {"valid": percent(row["valid_share"]), "wrong": percent(row["wrong_share"])}
    return {
        "": {"recordings": str(row["recordings"]), **shares},
        **{f"{of}, {unit}": _typical(row[of]) for of, unit in tracks.QUANTITIES.items()},
        "90 % interval holds": {of: percent(row[f"{of}_coverage"]) for of in tracks.COVERED},
        "phantom, s": {"a recording": number(row["phantom_s"])},
        "first, s": {**_typical(row["first_s"]), "none": str(row["never"])},
    }


def _typical(values: Mapping[str, float | None]) -> dict[str, Cell]:
    return {kind: number(values[kind]) for kind in ("median", "p95")}

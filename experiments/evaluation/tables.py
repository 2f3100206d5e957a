"""Tables of errors, as `macros.html.j2` shows them: texts by row, group of columns and column."""

from collections.abc import Mapping
from typing import Any

from markupsafe import Markup

from softslide.experiments.evaluation import tracks
from softslide.experiments.evaluation.scoring import INTERVALS, QUANTITIES, WORDS
from softslide.experiments.pages.page import number, percent

Table = dict[str, dict[str, dict[str, str]]]
SHOWN = WORDS | {"position_mm": "position"}


def error_table(groups: Mapping[str, Mapping[str, Any]]) -> Table:
    """groups: `scoring.summary` by name."""
    return {name: _errors(row) for name, row in groups.items()}


def _errors(row: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    cells = {"": {"recordings": str(row["recordings"]), "valid": percent(row["valid_share"])}}
    for quantity, word in SHOWN.items():
        of = row[quantity]
        kinds = {kind: number(of.get(kind)) for kind in ("mean", "p95", "max")}
        # The recording behind it shows when the pointer rests on it.
        kinds["max"] = Markup('<span title="{}">{}</span>').format(of.get("worst", ""), kinds["max"])
        cells[f"{word}, {QUANTITIES[quantity]}"] = kinds
    held = zip(WORDS.values(), INTERVALS, strict=True)
    return cells | {
        "90 % interval holds": {
            word: percent(row[f"{column}_coverage"].get("share")) for word, column in held
        }
    }


def track_table(splits: Mapping[str, Mapping[str, Any]]) -> Table:
    """splits: `tracks.summarize` by name."""
    return {split: _track(row) for split, row in splits.items()}


def _track(row: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    shares = {"valid": percent(row["valid_share"]), "wrong": percent(row["wrong_share"])}
    errors = {f"{of}, {unit}": _typical(row[of]) for of, unit in tracks.QUANTITIES.items()}
    return {
        "": {"recordings": str(row["recordings"])} | shares,
        **errors,
        "90 % interval holds": {of: percent(row[f"{of}_coverage"]) for of in tracks.COVERED},
        "phantom, s": {"a recording": number(row["phantom_s"])},
        "first, s": _typical(row["first_s"]) | {"none": str(row["never"])},
    }


def _typical(values: Mapping[str, float | None]) -> dict[str, str]:
    return {kind: number(values[kind]) for kind in ("median", "p95")}

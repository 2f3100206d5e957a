"""The comparison as numbers: a row for each folder, split, model and stroke fraction; and as Markdown to read."""

import math
from typing import Any

import numpy as np
import pandas as pd

from experiments.evaluation.scoring import summary
from experiments.pages.page import ORIGINS, number

# Stroke fractions that the Markdown shows; the figure and comparison.csv have them all.
SHOWN = {1.0: "At the end of the stroke", 0.4: "After 2/5 of the stroke"}
NO_ERROR = (
    "A mean error of exactly nothing (a direction that is one of four) has no place on the figure's scale."
)
HEAD = (
    "split",
    "model",
    "valid, %",
    "direction, deg",
    "speed, %",
    "distance, mm",
    "depth, mm",
    "90 % intervals hold, %",
)
# What is scored, by a column's first word: its name in `scoring.summary`, and the column's unit.
QUANTITIES = {
    "direction": ("direction_deg", "deg"),
    "speed": ("speed_percent", "percent"),
    "offset": ("offset_mm", "mm"),
}
INTERVALS = {"direction": "direction_deg", "speed": "speed_mm_s", "offset": "offset_mm"}


def error_rows(scored: pd.DataFrame) -> list[dict[str, Any]]:
    """For each split and stroke fraction of `scoring.score`'s table: rows, valid share, errors of valid estimates,
    and the share of their intervals that hold; NaN where there is none."""
    rows = []
    for (split, fraction), part in scored.groupby(["split", "stroke_fraction"]):
        found = summary(part)
        row = {
            "split": split,
            "stroke_fraction": fraction,
            "n": len(part),
            "valid_share": found["valid_share"],
        }
        for name, (quantity, unit) in QUANTITIES.items():
            for kind in ("mean", "max"):
                row[f"{name}_{kind}_{unit}"] = found[quantity].get(kind, np.nan)
        depth = (part["depth_mm"] - part["true_depth_mm"]).abs()[part["valid"].astype(bool)]
        row["depth_mean_mm"] = depth.mean()
        for name, column in INTERVALS.items():
            row[f"{name}_coverage"] = found[f"{column}_coverage"].get("share", np.nan)
        rows.append(row)
    return rows


def markdown(
    origin: str, errors: pd.DataFrame, times: pd.DataFrame, ratios: pd.DataFrame, left_out: dict[str, str]
) -> str:
    """Tables of one folder's errors, times and efficiency, and the way to its figures.

    origin: of its sensor.toml. errors, times, ratios: the folder's rows of comparison.csv, times.csv, efficiency.csv.
    left_out: models, and why.
    """
    folder = str(errors["folder"].iloc[0])
    text = [f"## {folder}", ""]
    text += [": ".join(ORIGINS[origin]), ""]
    text += [
        "Mean / largest errors of the estimates marked valid. Models abstain in different places: read errors beside",
        "the share that is valid.",
    ]
    text += [f"Left out is {model}: {why}." for model, why in left_out.items()]
    for fraction, when in SHOWN.items():
        rows = errors[np.isclose(errors["stroke_fraction"], fraction)].to_dict("records")
        text += ["", f"### {when}", "", *_table(HEAD, [_error_cells(row) for row in rows])]
    text += [
        "",
        f"![errors over the stroke](errors-{folder}.svg)",
        "",
        NO_ERROR,
        "",
        "### Time of one window",
        "",
    ]
    text += ["Median on one thread, beside a graph of one node called in turns.", ""]
    clocked = [[r["model"], number(r["window_ms"]), number(r["ratio"])] for r in times.to_dict("records")]
    text += _table(("model", "ms", "one-node calls"), clocked)
    if len(ratios):
        text += ["", "### Rms error over the Cramer-Rao bound", ""]
        text += ["Of the calibrated map, at its contact depth: direction / speed / distance.", ""]
        text += [*_efficiency(ratios), "", f"![errors over the bound](efficiency-{folder}.svg)"]
    return "\n".join(text) + "\n"


def _error_cells(row: dict[Any, Any]) -> list[str]:
    errors = [
        f"{number(row[f'{name}_mean_{unit}'], 2)} / {number(row[f'{name}_max_{unit}'], 2)}"
        for name, (_, unit) in QUANTITIES.items()
    ]
    coverage = [row[f"{name}_coverage"] for name in INTERVALS]
    held = " / ".join("–" if math.isnan(share) else f"{100 * share:.0f}" for share in coverage)
    valid = f"{100 * row['valid_share']:.0f}"
    return [row["split"], row["model"], valid, *errors, number(row["depth_mean_mm"], 2), held]


def _efficiency(ratios: pd.DataFrame) -> list[str]:
    fractions = sorted(ratios["stroke_fraction"].unique())
    columns = ["direction_deg_ratio", "log_speed_ratio", "offset_mm_ratio"]
    body = []
    for (model, distance), part in ratios.groupby(["model", "distance_mm"], sort=False):
        cells = {
            row["stroke_fraction"]: " / ".join(number(row[c], 2) for c in columns)
            for row in part.to_dict("records")
        }
        body.append([str(model), str(distance), *(cells.get(fraction, "–") for fraction in fractions)])
    return _table(("model", "distance, mm", *(f"stroke {fraction:.1f}" for fraction in fractions)), body)


def _table(head: tuple[str, ...], body: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body)]

"""comparison.html: the models side by side, by differences of their errors on the same slides."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd

from experiments.comparison.paired import QUANTITIES
from experiments.pages.figures import COLOURS, INK, LEGEND_ROW_INCHES, Panel, inline, legend_below, panel

TEMPLATE = Path(__file__).parent / "comparison.html.j2"
WORDS = {"direction_deg": "direction", "speed_percent": "speed", "offset_mm": "distance"}
# Columns of comparison.csv with the mean error of each quantity.
MEANS = {
    "direction_deg": "direction_mean_deg",
    "speed_percent": "speed_mean_percent",
    "offset_mm": "offset_mean_mm",
}
ROW_INCHES = 0.16


def section(
    folder: str, origin: str, errors: pd.DataFrame, pairs: pd.DataFrame, taught: int
) -> dict[str, Any]:
    """One folder's part of the page, as the template takes it.

    errors, pairs: its rows of comparison.csv and paired.csv. taught: number of recordings that are not paired since
    they run along calibration lines.
    """
    end = errors[errors["stroke_fraction"] == 1.0]
    return {
        "folder": folder,
        "origin": origin,
        "taught": taught,
        "against": None if pairs.empty else pairs["against"].iloc[0],
        "panels": [] if pairs.empty else [_differences(pairs, quantity) for quantity in QUANTITIES],
        "rows": _rows(pairs),
        "means": [
            row | {quantity: row[column] for quantity, column in MEANS.items()}
            for row in end.to_dict("records")
        ],
        "words": {quantity: f"{WORDS[quantity]}, {unit}" for quantity, unit in QUANTITIES.items()},
    }


def verdict(row: dict[Any, Any]) -> str:
    """Of a row of paired.csv: errors "smaller" or "larger" than the other's, "" where the interval holds zero, "too
    few" lines for one."""
    if np.isnan(row["low"]):
        return "too few"
    return "smaller" if row["high"] < 0 else "larger" if row["low"] > 0 else ""


def _rows(pairs: pd.DataFrame) -> list[dict[str, Any]]:
    """A row each split and model: counts, and each quantity's row with its verdict."""
    return [
        {
            "split": split,
            "model": model,
            "quantities": {
                row["quantity"]: row | {"verdict": verdict(row)} for row in part.to_dict("records")
            },
        }
        for (split, model), part in pairs.groupby(["split", "model"], sort=False)
    ]


def _differences(pairs: pd.DataFrame, quantity: str) -> Panel:
    """A row a model, in it a dot with its interval a split; linear about zero, logarithmic beyond."""
    rows = pairs[pairs["quantity"] == quantity]
    models, splits = list(dict.fromkeys(rows["model"])), list(dict.fromkeys(rows["split"]))
    word, unit, against = WORDS[quantity], QUANTITIES[quantity], rows["against"].iloc[0]
    lines_below = LEGEND_ROW_INCHES * ((len(splits) + 1) // 2)
    height = 1.0 + lines_below + ROW_INCHES * len(models) * (len(splits) + 1)
    with panel(height, below=lines_below, left=1.15) as (figure, ax):
        ax.axvline(0.0, color=INK, linestyle="--", linewidth=1)
        for n, split in enumerate(splits):
            part = rows[rows["split"] == split]
            place = [models.index(model) * (len(splits) + 1) + n for model in part["model"]]
            colour = COLOURS[n % len(COLOURS)]
            ax.hlines(place, part["low"], part["high"], color=colour, linewidth=2)
            ax.plot(part["difference"], place, "o", color=colour, markersize=4, label=split)
        _about_zero(ax, rows[["difference", "low", "high"]].to_numpy(float))
        middle = (len(splits) - 1) / 2
        ax.set_yticks([n * (len(splits) + 1) + middle for n in range(len(models))], models)
        ax.set_ylim(len(models) * (len(splits) + 1) - 0.5, -1.5)
        ax.grid(axis="y", visible=False)
        ax.set(xlabel=f"error less that of {against}, {unit}", title=f"{word}: right of zero is worse")
        legend_below(figure, ax)
        text = (
            f"Mean difference of the {word} error ({unit}), each model less {against} on the same slides, by split; "
            "bars: 95 % confidence intervals over lines. A bar that does not reach zero: the two differ."
        )
        return Panel(inline(figure, text), text)


def _about_zero(ax: mpl.axes.Axes, drawn: np.ndarray) -> None:
    """An axis that shows differences of a hundredth and of ten beside each other."""
    sizes = np.abs(drawn[np.isfinite(drawn) & (drawn != 0)])
    if not len(sizes):
        return
    most = np.ceil(np.log10(sizes.max()))
    linear = int(max(np.floor(np.log10(np.quantile(sizes, 0.25))), most - 3))
    decades = 10.0 ** np.arange(linear, most + 1)
    ax.set_xscale("symlog", linthresh=10.0**linear, linscale=0.7)
    low, high = np.nanmin(drawn), np.nanmax(drawn)
    ax.set_xlim(min(1.3 * low, -0.3 * 10.0**linear), max(1.3 * high, 0.3 * 10.0**linear))
    shown = [
        mark for mark in (*-decades[::-1], 0.0, *decades) if 1.3 * low <= mark <= 1.3 * high or mark == 0
    ]
    ax.xaxis.set_major_locator(mpl.ticker.FixedLocator(shown))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(mpl.ticker.NullLocator())

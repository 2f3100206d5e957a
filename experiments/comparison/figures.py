"""The comparison's figures: errors over the stroke by model, and errors over the Cramer-Rao bound, as SVG texts."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.pages.figures import COLOURS, STYLE, svg

QUANTITIES = {
    "direction_mean_deg": "direction error, deg",
    "speed_mean_percent": "speed error, %",
    "offset_mean_mm": "distance error, mm",
}
RATIOS = {"direction_deg_ratio": "direction", "log_speed_ratio": "speed", "offset_mm_ratio": "distance"}
# A mean over a smaller share of valid slides than this is drawn hollow.
FEW = 0.5


def errors(table: pd.DataFrame) -> str:
    """Mean error of the valid estimates over the stroke: a row a quantity, a column a split, a line a model.

    table: one folder's rows of comparison.csv.
    """
    splits, models = table["split"].unique(), list(table["model"].unique())
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(2.2 + 2.6 * len(splits), 8.0), layout="constrained")
        axes = figure.subplots(len(QUANTITIES), len(splits), sharex=True, sharey="row", squeeze=False)
        for row, (column, title) in zip(axes, QUANTITIES.items(), strict=True):
            for ax, split in zip(row, splits, strict=True):
                for model in models:
                    part = table[(table["split"] == split) & (table["model"] == model)]
                    _line(ax, part, column, _look(model, models))
            _logarithmic(row[0], table[column])
            row[0].set_ylabel(f"mean {title}")
        for ax, split in zip(axes[0], splits, strict=True):
            ax.set_title(split, fontsize=10, loc="left", color="#1c2328")
        for ax in axes[-1]:
            ax.set_xlabel("share of the stroke seen")
            ax.set_xlim(0.05, 1.05)
        handles = [
            mpl.lines.Line2D([], [], marker="o", markersize=4, label=m, **_look(m, models)) for m in models
        ]
        hollow = mpl.lines.Line2D(
            [], [], marker="o", markersize=4, color="#8a939b", markerfacecolor="white", linestyle="none"
        )
        hollow.set_label(f"valid for fewer than {FEW:.0%} of the slides".replace("%", " %"))
        figure.legend(handles=[*handles, hollow], loc="outside lower center", ncols=4, frameon=False)
        return svg(figure)


def efficiency(table: pd.DataFrame) -> str:
    """Rms error over the bound along the stroke: a row a model, a column a quantity, a line a bin of distance.

    table: one folder's rows of efficiency.csv.
    """
    models, bins = table["model"].unique(), table["distance_mm"].unique()
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 0.9 + 2.7 * len(models)), layout="constrained")
        axes = figure.subplots(len(models), len(RATIOS), sharex=True, sharey=True, squeeze=False)
        for row, model in zip(axes, models, strict=True):
            for ax, (column, title) in zip(row, RATIOS.items(), strict=True):
                ax.axhline(1.0, color="#1c2328", linewidth=1.0, linestyle="--")
                for n, distance in enumerate(bins):
                    part = table[(table["model"] == model) & (table["distance_mm"] == distance)]
                    ax.plot(
                        part["stroke_fraction"],
                        part[column],
                        marker="o",
                        markersize=4,
                        linewidth=1.6,
                        color=COLOURS[n],
                        label=f"{distance} mm",
                    )
                _logarithmic(ax, table[column])
                ax.set_title(f"{model}: {title}", fontsize=10, loc="left", color="#1c2328")
            row[0].set_ylabel("rms error / bound")
        for ax in axes[-1]:
            ax.set_xlabel("share of the stroke seen")
        handles, names = axes[0, 0].get_legend_handles_labels()
        figure.legend(
            handles,
            names,
            title="distance of the line",
            loc="outside lower center",
            ncols=len(bins),
            frameon=False,
        )
        return svg(figure)


def _look(model: str, models: Sequence[str]) -> dict:
    """The default model in bold black; each other model in a colour of its own, in every figure; bundles dashed, in the
    order of the figure's models."""
    others = ("interpolation", "trees", "mlp", "gp", "minirocket", "inversion")
    if model in others:
        return {"color": COLOURS[others.index(model)], "linewidth": 1.4}
    if model == "cnn":
        return {"color": "#1c2328", "linewidth": 2.4}
    return {"color": COLOURS[models.index(model) % len(COLOURS)], "linewidth": 1.8, "linestyle": "--"}


def _line(ax: Axes, part: pd.DataFrame, column: str, look: dict) -> None:
    # An error of exactly zero, as of one of four directions, cannot be shown on a logarithmic scale.
    part = part[part[column] > 0]
    ax.plot(part["stroke_fraction"], part[column], **look)
    face = np.where(part["valid_share"] < FEW, "white", look["color"])
    ax.scatter(
        part["stroke_fraction"],
        part[column],
        s=16,
        c=face,
        edgecolors=look["color"],
        linewidths=1,
        zorder=3,
    )


def _logarithmic(ax: Axes, drawn: pd.Series) -> None:
    """Of the axes and those that share its scale, if anything that they show is above zero."""
    if (drawn > 0).any():
        ax.set_yscale("log")
        reach = drawn[drawn > 0].max() / drawn[drawn > 0].min()
        ax.yaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1.0, 2.0, 5.0) if reach < 100 else (1.0,)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_locator(mpl.ticker.NullLocator())

"""The report's figures, drawn without a display, as SVG texts that are the same for the same numbers."""

import io
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart with any colour vision.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "softslide",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e4e7ea",
    "axes.edgecolor": "#8a939b",
    "axes.labelcolor": "#3b444b",
    "xtick.color": "#3b444b",
    "ytick.color": "#3b444b",
    "axes.axisbelow": True,
}
PANELS = (
    ("direction_deg", "direction error, deg"),
    ("speed_percent", "speed error, %"),
    ("offset_mm", "distance error, mm"),
)


def along_the_stroke(scored: pd.DataFrame) -> str:
    """Mean error of each split against the share of the stroke seen, one panel a quantity."""

    def draw(ax: Axes, quantity: str, rows: pd.DataFrame, look: dict) -> bool:
        mean = rows.groupby("stroke_fraction")[f"{quantity}_error"].mean().dropna()
        ax.plot(mean.index, mean, marker="o", markersize=4, linewidth=1.6, **look)
        ax.set_xlabel("share of the stroke seen")
        ax.set_xlim(0.05, 1.05)
        return bool((mean > 0).any())

    return _panels(scored, draw, "mean ")


def recording_by_recording(scored: pd.DataFrame) -> str:
    """Error of each recording at the end of its stroke against the label it is an error of."""
    labels = {
        "direction_deg": ("true_direction_deg", "direction, deg"),
        "speed_percent": ("true_speed_mm_s", "speed, mm/s"),
        "offset_mm": ("true_offset_mm", "offset, mm"),
    }
    end = scored[scored["stroke_fraction"] == 1.0]

    def draw(ax: Axes, quantity: str, rows: pd.DataFrame, look: dict) -> bool:
        label, title = labels[quantity]
        error = rows[f"{quantity}_error"]
        ax.plot(rows[label], error, "o", markersize=4, alpha=0.75, markeredgewidth=0, **look)
        ax.set_xlabel(title)
        if quantity == "direction_deg":
            ax.set_xlim(-12, 372)
            ax.set_xticks([0, 90, 180, 270, 360])
        if quantity == "speed_percent":
            ax.set_xscale("log")
            ax.xaxis.set_major_locator(mpl.ticker.FixedLocator([0.5, 1, 2, 4, 8, 13]))
            ax.xaxis.set_major_formatter("{x:g}")
            ax.xaxis.set_minor_locator(mpl.ticker.NullLocator())
        return bool((error > 0).any())

    return _panels(end, draw, "")


def _panels(rows: pd.DataFrame, draw, prefix: str) -> str:
    """Three panels side by side, a colour for each split, errors on a logarithmic scale if there are any."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.5), layout="constrained")
        axes = figure.subplots(1, len(PANELS))
        for ax, (quantity, title) in zip(axes, PANELS, strict=True):
            positive = False
            for n, (split, part) in enumerate(rows.groupby("split")):
                look = {"color": COLOURS[n % len(COLOURS)], "label": split}
                positive |= draw(ax, quantity, part, look)
            if positive:
                ax.set_yscale("log")
                ax.yaxis.set_major_formatter("{x:g}")
                ax.yaxis.set_minor_locator(mpl.ticker.LogLocator(subs=(2, 5)))
                ax.yaxis.set_minor_formatter("{x:g}")
            ax.set_title(prefix + title, fontsize=10, loc="left", pad=10, color="#1c2328")
        handles, names = axes[0].get_legend_handles_labels()
        if handles:
            figure.legend(handles, names, loc="outside lower center", ncols=len(names), frameon=False)
        return svg(figure)


def svg(figure: Figure) -> str:
    """The figure as a text, without the date that would make two of the same numbers differ."""
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()

"""Figures without a display: as SVG texts that are the same for the same numbers, and as part of a page.

A figure in a page is narrow, about as wide as a phone, so that its text stays legible there; wide screens show several
side by side. It takes its colours from the page, which has a set for light and one for dark.
"""

import html
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure

from softslide.pipeline.sensor import Sensor

# Okabe and Ito's palette: distinct with any colour vision.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
INK, LABEL, EDGE, GRID = "#1c2328", "#3b444b", "#8a939b", "#e4e7ea"
# Of all that a figure has, so that a `matplotlibrc` in the current folder changes nothing.
STYLE: dict[Any, Any] = {name: value for name, value in mpl.rcParamsDefault.items() if name != "backend"} | {
    "svg.hashsalt": "softslide",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 10,
    "text.color": INK,
    "axes.titlecolor": INK,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "axes.edgecolor": EDGE,
    "axes.labelcolor": LABEL,
    "xtick.color": LABEL,
    "ytick.color": LABEL,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "legend.fontsize": 9,
}
# The page's colour in place of each of the figure's.
IN_PAGE = {colour: f"var(--series-{n})" for n, colour in enumerate(COLOURS)}
IN_PAGE |= {INK: "var(--ink)", LABEL: "var(--label)", EDGE: "var(--edge)", GRID: "var(--grid)"}
# Inches: at 72 points an inch 302 points, which a phone of 400 px shows a fifth larger.
PANEL_INCHES = (4.2, 3.1)
MARGINS = (0.68, 0.14, 0.5, 0.32)  # left, right, bottom, top, inches
LEGEND_ROW_INCHES, LEGEND_COLUMNS = 0.18, 2
MOST_MARKS = 9  # of a logarithmic axis
ROW_INCHES, LETTER_INCHES = 0.16, 0.05  # of `intervals`


def draw_sensor(ax: Axes, sensor: Sensor, width: float, label: str) -> None:
    """The chamber's edge, in a line of so many points, and the accelerometers; label: theirs in the legend."""
    x, y = np.array(sensor.chamber_mm) / 2
    ax.add_patch(mpl.patches.Rectangle((-x, -y), 2 * x, 2 * y, fill=False, edgecolor=LABEL, linewidth=width))
    places = np.array([(part.x_mm, part.y_mm) for part in sensor.accelerometers])
    ax.plot(*places.T, "s", color=INK, markersize=5, label=label)


@dataclass(frozen=True)
class Panel:
    """One figure of a page. svg: of `inline`; caption: a sentence of what it shows."""

    svg: str
    caption: str


def drawn(
    caption: str,
    draw: Callable[[Axes], None],
    height: float = PANEL_INCHES[1],
    *,
    left: float = MARGINS[0],
    **options: Any,
) -> Panel:
    """A panel of one pair of axes in the page's style, that `draw` draws into; what has a label is named below.

    height, left: inches, of the figure without its legend and of the margin at the left. options: of `add_subplot`. The
    margins are fixed: to fit them to each figure takes as long as to draw it.
    """
    width, (_, right, bottom, top) = PANEL_INCHES[0], MARGINS
    with mpl.rc_context(STYLE):
        figure = Figure()
        ax = figure.add_subplot(**options)
        draw(ax)
        handles, names = ax.get_legend_handles_labels()
        below = LEGEND_ROW_INCHES * -(-len(names) // LEGEND_COLUMNS)
        figure.set_size_inches(width, height + below)
        low, high = (bottom + below) / (height + below), 1 - top / (height + below)
        figure.subplots_adjust(left / width, low, 1 - right / width, high)
        if handles:
            figure.legend(handles, names, loc="lower center", ncols=LEGEND_COLUMNS, fontsize=8)
        return Panel(inline(figure, caption), caption)


def chart(
    table: pd.DataFrame,
    x: str,
    y: str,
    by: str,
    labels: tuple[str, str, str],
    caption: str,
    *,
    mark: str = "o",
    colours: Sequence[str] = COLOURS,
    limit: float | None = None,
    log: bool = False,
    draw: Callable[[Axes], None] = lambda ax: None,
    **axes: Any,
) -> Panel:
    """A panel of column `y` against column `x`, a series for each value of column `by` in the order of the rows.

    labels: title, and what x and y are. mark: Matplotlib's format. limit: drawn dashed. log: y logarithmic, with zero.
    draw: draws the rest. axes: of `Axes.set`.
    """

    def series(ax: Axes) -> None:
        draw(ax)
        for n, (name, rows) in enumerate(table.groupby(by, sort=False)):
            look: Any = {"alpha": 0.8} if mark == "o" else {}
            colour, line = colours[n % len(colours)], ("-", "--")[n // len(colours) % 2]
            ax.plot(
                rows[x], rows[y], mark.replace("-", line), markersize=3, color=colour, label=str(name), **look
            )
        if limit is not None:
            ax.axhline(limit, color=INK, linestyle="--", linewidth=1)
        if log:
            log_about_zero(ax.yaxis, np.array([*table[y].astype(float), *([] if limit is None else [limit])]))
        ax.set(title=labels[0], xlabel=labels[1], ylabel=labels[2], **axes)

    return drawn(caption, series)


def intervals(
    table: pd.DataFrame,
    row: str,
    by: str,
    labels: tuple[str, str],
    caption: str,
    *,
    line: float,
    log: bool = False,
    **axes: Any,
) -> Panel:
    """A panel of columns `middle`, `low` and `high`, dots with bars: a row for each value of column `row`, in it a
    colour for each value of column `by`, in the order of the rows.

    labels: title, and what the values are. line: drawn dashed. log: values logarithmic, with zero. axes: of `Axes.set`.
    """
    names, series = list(dict.fromkeys(table[row])), list(dict.fromkeys(table[by]))
    every = len(series) + 1

    def dots(ax: Axes) -> None:
        ax.axvline(line, color=INK, linestyle="--", linewidth=1)
        for n, name in enumerate(series):
            part, colour = table[table[by] == name], COLOURS[n % len(COLOURS)]
            place = [names.index(each) * every + n for each in part[row]]
            ax.hlines(place, part["low"], part["high"], color=colour, linewidth=2)
            ax.plot(part["middle"], place, "o", color=colour, markersize=4, label=name)
        if log:
            log_about_zero(ax.xaxis, table[["middle", "low", "high"]].to_numpy(float))
        ax.set_yticks([n * every + (len(series) - 1) / 2 for n in range(len(names))], names)
        ax.grid(axis="y", visible=False)
        ax.set(ylim=(len(names) * every - 0.5, -1.5), title=labels[0], xlabel=labels[1], **axes)

    left = MARGINS[0] + LETTER_INCHES * max(len(str(name)) for name in names)
    return drawn(caption, dots, 1.0 + ROW_INCHES * len(names) * every, left=left)


def on_skin(sensor: Sensor, caption: str, draw: Callable[[Axes], None], title: str = "") -> Panel:
    """A panel of the skin from above, x and y in mm, with the chamber and the accelerometers; else as `drawn`."""
    x, y = np.array(sensor.chamber_mm) / 2

    def skin(ax: Axes) -> None:
        draw(ax)
        draw_sensor(ax, sensor, width=1.2, label="sensor")
        ax.set(xlim=(-x - 6, x + 6), ylim=(-y - 6, y + 6), aspect="equal", title=title)
        ax.set(xlabel="x, mm", ylabel="y, mm")

    return drawn(caption, skin, 4.1)


def on_cells(
    sensor: Sensor,
    caption: str,
    values: Mapping[Any, float],
    cell_mm: float,
    form: str,
    title: str,
    scale: Any = None,
    draw: Callable[[Axes], None] = lambda ax: None,
) -> Panel:
    """`on_skin`, with square cells in colour, each with its number. values: by the cell's middle (x, y) mm.

    scale: from a value to [0, 1] of the colours; by default from zero to the largest. draw: draws the rest.
    """
    colours, half = mpl.colormaps["viridis"], np.array(sensor.chamber_mm) / 2
    scale = scale or mpl.colors.Normalize(0.0, max([*values.values(), 1e-9]))

    def fill(ax: Axes) -> None:
        for middle, value in values.items():
            low, high = (np.clip(np.array(middle) + side * cell_mm / 2, -half, half) for side in (-1, 1))
            rectangle(ax, low, high, facecolor=colours(scale(value)), linewidth=0)
            ink, (x, y) = "#ffffff" if scale(value) < 0.6 else "#000000", (low + high) / 2
            size = 4 + 0.4 * cell_mm
            ax.text(x, y, form.format(value), ha="center", va="center", color=ink, fontsize=size)
        ax.grid(visible=False)
        draw(ax)

    return on_skin(sensor, caption, fill, title)


def rectangle(ax: Axes, low: np.ndarray, high: np.ndarray, **look: Any) -> None:
    """Between two corners (2,)."""
    ax.add_patch(mpl.patches.Rectangle((float(low[0]), float(low[1])), *(high - low), **look))


def inline(figure: Figure, alt: str) -> str:
    """The figure as an SVG element of an HTML page, in the page's colours; alt: what it shows, for who cannot see it.

    A page needs neither its XML head nor its name spaces nor its metadata, whose date would make two figures of the
    same numbers differ.
    """
    figure.patch.set_alpha(0.0)
    for axes in figure.axes:
        axes.patch.set_alpha(0.0)
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    head = re.search(r'viewBox="[^"]*"', text)
    assert head is not None
    body = text[text.index(">") + 1 :]
    for colour, variable in IN_PAGE.items():
        body = body.replace(colour, variable)
    return f'<svg {head.group()} role="img" aria-label="{html.escape(alt)}">{body}'


def axis_marks(axis: Axis, marks: Sequence[float]) -> None:
    """These marks alone."""
    locator, nowhere = mpl.ticker.FixedLocator(marks), mpl.ticker.NullLocator()
    axis.set(major_locator=locator, major_formatter="{x:g}", minor_locator=nowhere)


def log_about_zero(axis: Axis, values: np.ndarray) -> None:
    """Makes an axis logarithmic either way from zero, on which zero lies too: it shows hundredths next to tens.

    It is linear about zero, to a third of the sizes' lower quartile, or a thousandth of the largest if that is more.
    """
    known = values[np.isfinite(values)]
    sizes = np.abs(known[known != 0])
    if not len(sizes):
        return
    least, most = max(np.quantile(sizes, 0.25) / 3, sizes.max() / 1000), sizes.max()
    low, high = min(1.3 * known.min(), -0.3 * least), max(1.3 * known.max(), 0.3 * least)
    scale = mpl.scale.SymmetricalLogScale(axis, linthresh=least, linscale=0.5)
    name = "x" if axis is axis.axes.xaxis else "y"
    axis.axes.set(**{f"{name}scale": scale, f"{name}lim": (low, high)})
    decades = 10.0 ** np.arange(np.floor(np.log10(least)), np.ceil(np.log10(most)) + 1)

    def marks(multiples: tuple[int, ...]) -> list[float]:
        steps = np.outer(decades, multiples).ravel()
        steps = steps[steps > 1.2 * least]
        return [mark for mark in (*-steps[::-1], 0.0, *steps) if low <= mark <= high]

    # The marks of an x axis are wider than those of a y axis are high.
    fine = marks((1, 2, 5))
    axis_marks(axis, fine if name == "y" and len(fine) <= MOST_MARKS else marks((1,)))

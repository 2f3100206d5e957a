"""Pictures of followed contacts: the path on the skin, and place, speed and direction against time."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from experiments.evaluation.figures import COLOURS, STYLE, svg
from experiments.evaluation.tracks import Track, summarize
from pipeline.sensor import Sensor

# Of each split: the best, the middle and the worst, by the median error of place.
PICTURES = 3
# More points than this make the report large and the pictures no better.
_POINTS = 400
_TRUE, _SAID = "#8a939b", COLOURS[0]
# Seconds of a bin of errors against time, and how many.
_BIN_S, _BINS = 1.0, 60
_ERRORS = (
    ("position_error", "place error, mm"),
    ("direction_error", "direction error, deg"),
    ("speed_error", "speed error, %"),
)


def along_the_contact(followed: Sequence[Track]) -> str:
    """Median error of each split against the time since the touch, a panel a quantity."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 3.9), layout="constrained")
        axes = figure.subplots(1, len(_ERRORS))
        splits = dict.fromkeys(track.split for track in followed)
        for n, split in enumerate(splits):
            rows = pd.concat([_since_touch(track) for track in followed if track.split == split])
            look = {"color": COLOURS[n % len(COLOURS)], "linestyle": ("-", "--")[n // len(COLOURS) % 2]}
            for ax, (column, _) in zip(axes, _ERRORS, strict=True):
                counted = rows if column == "position_error" else rows[rows["moving"]]
                middle = counted.groupby("bin")[column].median()
                ax.plot(_BIN_S * (middle.index + 0.5), middle, linewidth=1.6, label=split, **look)
        for ax, (_, title) in zip(axes, _ERRORS, strict=True):
            if ax.has_data() and any((line.get_ydata() > 0).any() for line in ax.lines):
                ax.set_yscale("log")
                ax.yaxis.set_major_formatter("{x:g}")
            ax.set_xlabel("time since the touch, s")
            ax.set_title(f"median {title}", fontsize=10, loc="left", pad=10, color="#1c2328")
        handles, names = axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=min(len(names), 6), frameon=False)
        return svg(figure)


def pictures(followed: Sequence[Track], sensor: Sensor) -> str:
    """Some recordings of one split: true and estimated path on the skin; speed and direction against time."""
    chosen = _chosen(followed)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(11, 6.6), layout="constrained")
        grid = figure.subplots(3, PICTURES, squeeze=False, height_ratios=(3, 1, 1))
        for column, track in zip(grid.T, chosen, strict=False):
            _on_the_skin(column[0], track, sensor)
            _against_time(column[1], track, "speed_mm_s", "mm/s")
            _against_time(column[2], track, "direction_deg", "deg")
            column[2].set_xlabel("time, s")
        for ax in grid[:, len(chosen) :].flat:
            ax.set_axis_off()
        handles, names = grid[0, 0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=len(names), frameon=False)
        return svg(figure)


def _since_touch(track: Track) -> pd.DataFrame:
    """Absolute errors of the live estimates in contact, with the bin of time since the touch."""
    rows = track.judged[track.judged["touching"]]
    bins = ((rows["time_s"] - rows["time_s"].min()) // _BIN_S).astype(int)
    table = rows[[column for column, _ in _ERRORS]].abs().assign(bin=bins, moving=rows["moving"])
    return table[rows["live"] & (bins < _BINS)]


def _chosen(followed: Sequence[Track]) -> list[Track]:
    """Best, middle and worst recording; one without any estimate is the worst."""

    def error(track: Track) -> float:
        median = summarize([track.judged])["position"]["median"]
        return np.inf if median is None else median

    ranked = sorted(followed, key=error)
    places = np.unique(np.linspace(0, len(ranked) - 1, PICTURES).round().astype(int))
    return [ranked[place] for place in places]


def _on_the_skin(ax: Axes, track: Track, sensor: Sensor) -> None:
    x, y = np.array(sensor.chamber_mm) / 2
    ax.add_patch(Rectangle((-x, -y), 2 * x, 2 * y, fill=False, edgecolor="#c3c9ce", linewidth=1.0))
    ax.plot(
        [part.x_mm for part in sensor.accelerometers],
        [part.y_mm for part in sensor.accelerometers],
        "s",
        color="#3b444b",
        markersize=5,
        label="accelerometer",
    )
    truth = _thinned(track.truth[track.truth["contact"] > 0])
    ax.plot(truth["x_mm"], truth["y_mm"], color=_TRUE, linewidth=5, alpha=0.5, label="true, in contact")
    rows = track.judged[track.judged["live"]]
    right, wrong = _thinned(rows[~rows["wrong"]]), _thinned(rows[rows["wrong"] | ~rows["touching"]])
    ax.plot(right["x_mm"], right["y_mm"], ".", color=_SAID, markersize=3, label="estimated")
    ax.plot(wrong["x_mm"], wrong["y_mm"], ".", color=COLOURS[1], markersize=3, label="estimated, wrong")
    ax.set_xlim(-x - 6, x + 6)
    ax.set_ylim(-y - 6, y + 6)
    ax.set_aspect("equal")
    ax.set_title(track.name, fontsize=10, loc="left", color="#1c2328")


def _against_time(ax: Axes, track: Track, column: str, unit: str) -> None:
    rows = track.judged[track.judged["touching"]]
    true = rows if column == "speed_mm_s" else rows[rows["moving"]]
    said = _thinned(rows[rows["live"]])
    ax.plot(_thinned(true)["time_s"], _thinned(true)[f"true_{column}"], ".", color=_TRUE, markersize=2)
    values = said[column]
    if column == "direction_deg":
        # Within 180 degrees of the truth.
        values = said["true_direction_deg"] + said["direction_error"]
    ax.plot(said["time_s"], values, ".", color=_SAID, markersize=2)
    if column == "speed_mm_s" and len(true):
        ax.set_ylim(0, 1.6 * max(float(true[f"true_{column}"].max()), 0.1))
    ax.set_ylabel(unit)


def _thinned(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.iloc[:: max(1, -(-len(rows) // _POINTS))]

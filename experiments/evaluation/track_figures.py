"""Pictures of followed contacts: the path on the skin, and place, speed and direction against time."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.evaluation.tracks import Track, summarize
from experiments.pages.figures import (
    COLOURS,
    EDGE,
    LEGEND_ROW_INCHES,
    PANEL_INCHES,
    STYLE,
    Panel,
    draw_sensor,
    inline,
    legend_below,
    log_with_zero,
    panel,
)
from pipeline.sensor import Sensor

# Of each split: the best, the middle and the worst, by the median error of place.
PICTURES = 3
# More points than this make the report large and the pictures no better.
_POINTS = 400
_TRUE, _SAID = EDGE, COLOURS[0]
# Seconds of a bin of errors against time, and how many.
_BIN_S, _BINS = 1.0, 60
_ERRORS = (
    ("position_error", "place error, mm"),
    ("direction_error", "direction error, deg"),
    ("speed_error", "speed error, %"),
)


def along_the_contact(followed: Sequence[Track]) -> list[Panel]:
    """Median error of each split against the time since the touch, a panel a quantity."""
    splits = dict.fromkeys(track.split for track in followed)
    medians: dict[str, dict[str, pd.Series]] = {column: {} for column, _ in _ERRORS}
    for split in splits:
        rows = pd.concat([_since_touch(track) for track in followed if track.split == split])
        for column, _ in _ERRORS:
            counted = rows if column == "position_error" else rows[rows["moving"]]
            medians[column][split] = counted.groupby("bin")[column].median().dropna()
    panels = []
    for column, title in _ERRORS:
        rows_below = (len(splits) + 1) // 2
        with panel(3.1 + LEGEND_ROW_INCHES * rows_below, below=LEGEND_ROW_INCHES * rows_below) as (
            figure,
            ax,
        ):
            for n, (split, middle) in enumerate(medians[column].items()):
                look: Any = {
                    "color": COLOURS[n % len(COLOURS)],
                    "linestyle": ("-", "--")[n // len(COLOURS) % 2],
                }
                ax.plot(_BIN_S * (middle.index + 0.5), middle, linewidth=1.6, label=split, **look)
            log_with_zero(ax, np.concatenate([middle.to_numpy(float) for middle in medians[column].values()]))
            ax.set(xlabel="time since the touch, s", title=f"median {title}")
            legend_below(figure, ax)
            text = f"Median {title}, of valid estimates by the time since the touch, a line a split."
            panels.append(Panel(inline(figure, text), text))
    return panels


def pictures(followed: Sequence[Track], sensor: Sensor) -> list[Panel]:
    """Some recordings of one split: true and estimated path on the skin; speed and direction against time."""
    panels = []
    for track, word in zip(_chosen(followed), ("best", "middle", "worst"), strict=False):
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=(PANEL_INCHES[0], 6.6), layout="constrained")
            skin, speed, direction = figure.subplots(3, 1, height_ratios=(3, 1, 1))
            _on_the_skin(skin, track, sensor)
            _against_time(speed, track, "speed_mm_s", "mm/s")
            _against_time(direction, track, "direction_deg", "deg")
            direction.set_xlabel("time, s")
            handles, names = skin.get_legend_handles_labels()
            figure.legend(handles, names, loc="outside lower center", ncols=2, fontsize=8)
            text = f"{track.name}, the {word} of {track.split} by place: true and estimated path, speed and direction."
            panels.append(Panel(inline(figure, text), text))
    return panels


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
    draw_sensor(ax, sensor, width=1.0, label="accelerometer")
    truth = _thinned(track.truth[track.truth["contact"] > 0])
    ax.plot(truth["x_mm"], truth["y_mm"], color=_TRUE, linewidth=5, alpha=0.5, label="true, in contact")
    rows = track.judged[track.judged["live"]]
    right, wrong = _thinned(rows[~rows["wrong"]]), _thinned(rows[rows["wrong"] | ~rows["touching"]])
    ax.plot(right["x_mm"], right["y_mm"], ".", color=_SAID, markersize=3, label="estimated")
    ax.plot(wrong["x_mm"], wrong["y_mm"], ".", color=COLOURS[1], markersize=3, label="estimated, wrong")
    ax.set_xlim(-x - 6, x + 6)
    ax.set_ylim(-y - 6, y + 6)
    ax.set_aspect("equal")
    ax.set_title(track.name)


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

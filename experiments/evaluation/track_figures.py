"""Pictures of followed contacts: the path on the skin, and place, speed and direction against time."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from softslide.experiments.evaluation.tracks import Track, summarize
from softslide.experiments.pages.figures import (
    COLOURS,
    EDGE,
    PANEL_INCHES,
    STYLE,
    Panel,
    chart,
    draw_sensor,
    inline,
)
from softslide.pipeline.sensor import Sensor

# Of each split: the best, the middle and the worst, by the median error of place.
PICTURES = ("best", "middle", "worst")
# More points than this make the report large and the pictures no better.
_POINTS = 400
_TRUE, _ESTIMATED, _WRONG = EDGE, COLOURS[0], COLOURS[1]
# Seconds of a bin of errors against time, and how many.
_BIN_S, _BINS = 1.0, 60
_ERRORS = {
    "position_error": "place error, mm",
    "direction_error": "direction error, deg",
    "speed_error": "speed error, %",
}


def along_the_contact(followed: Sequence[Track]) -> list[Panel]:
    """Median error of each split against the time since the touch, a panel a quantity."""
    if not followed:
        return []
    rows, splits = pd.concat([_since_touch(track) for track in followed]), {track.split for track in followed}
    panels = []
    for column, title in _ERRORS.items():
        counted = rows if column == "position_error" else rows[rows["moving"]]
        medians = counted.groupby(["split", "time_s"], as_index=False)[[column]].median().dropna()
        text = f"Median {title}, of valid estimates by the time since the touch, a line a split."
        labels = (f"median {title}", "time since the touch, s", "")
        look: dict[str, Any] = {"mark": "-", "log": True, "below": len(splits)}
        panels.append(chart(medians, "time_s", column, "split", labels, text, **look))
    return panels


def _since_touch(track: Track) -> pd.DataFrame:
    """Absolute errors of the live estimates in contact, with the middle of their bin of time since the touch."""
    rows = track.judged[track.judged["touching"]]
    bins = (rows["time_s"] - rows["time_s"].min()) // _BIN_S
    moment = {"time_s": _BIN_S * (bins + 0.5), "moving": rows["moving"]}
    table = rows[list(_ERRORS)].abs().assign(split=track.split, **moment)
    return table[rows["live"] & (bins < _BINS)]


def pictures(followed: Sequence[Track], sensor: Sensor) -> list[Panel]:
    """Some recordings of one split: true and estimated path on the skin; speed and direction against time."""
    panels = []
    for track, word in zip(_chosen(followed), PICTURES, strict=False):
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


def _chosen(followed: Sequence[Track]) -> list[Track]:
    """Best, middle and worst recording; one without any estimate is the worst."""

    def error(track: Track) -> float:
        median = summarize([track.judged])["position"]["median"]
        return np.inf if median is None else median

    ranked = sorted(followed, key=error)
    places = np.unique(np.linspace(0, len(ranked) - 1, len(PICTURES)).round().astype(int))
    return [ranked[place] for place in places]


def _on_the_skin(ax: Axes, track: Track, sensor: Sensor) -> None:
    x, y = np.array(sensor.chamber_mm) / 2
    draw_sensor(ax, sensor, width=1.0, label="accelerometer")
    truth = _thinned(track.truth[track.truth["contact"] > 0])
    ax.plot(truth["x_mm"], truth["y_mm"], color=_TRUE, linewidth=5, alpha=0.5, label="true, in contact")
    rows = track.judged[track.judged["live"]]
    wrong = rows["wrong"] | ~rows["touching"]
    for part, colour, name in ((~wrong, _ESTIMATED, "estimated"), (wrong, _WRONG, "estimated, wrong")):
        shown = _thinned(rows[part])
        ax.plot(shown["x_mm"], shown["y_mm"], ".", color=colour, markersize=3, label=name)
    ax.set(xlim=(-x - 6, x + 6), ylim=(-y - 6, y + 6), aspect="equal", title=track.name)


def _against_time(ax: Axes, track: Track, column: str, unit: str) -> None:
    rows = track.judged[track.judged["touching"]]
    true = _thinned(rows if column == "speed_mm_s" else rows[rows["moving"]])
    live = _thinned(rows[rows["live"]])
    ax.plot(true["time_s"], true[f"true_{column}"], ".", color=_TRUE, markersize=2)
    # A direction within 180 degrees of the truth.
    turned = live["true_direction_deg"] + live["direction_error"]
    estimated = turned if column == "direction_deg" else live[column]
    ax.plot(live["time_s"], estimated, ".", color=_ESTIMATED, markersize=2)
    if column == "speed_mm_s" and len(rows):
        ax.set_ylim(0, 1.6 * max(float(rows[f"true_{column}"].max()), 0.1))
    ax.set_ylabel(unit)


def _thinned(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.iloc[:: max(1, -(-len(rows) // _POINTS))]

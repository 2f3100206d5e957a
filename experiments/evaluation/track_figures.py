"""Pictures of followed contacts: the path on the skin, and place, speed and direction against time."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.evaluation.tracks import Track, summarize
from softslide.experiments.pages.figures import COLOURS, EDGE, Panel, chart, on_skin
from softslide.pipeline.sensor import Sensor

# Of each split: the best, the middle and the worst, by the median error of place.
PICTURES = ("best", "middle", "worst")
# More points than this make the report large and the pictures no better.
_POINTS = 400
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
    rows = pd.concat([_since_touch(track) for track in followed])
    panels = []
    for column, title in _ERRORS.items():
        counted = rows if column == "position_error" else rows[rows["moving"]]
        medians = counted.groupby(["split", "time_s"], as_index=False)[[column]].median().dropna()
        text = f"Median {title}, of valid estimates by the time since the touch, a line a split."
        labels = (f"median {title}", "time since the touch, s", "")
        panels.append(chart(medians, "time_s", column, "split", labels, text, mark="-", log=True))
    return panels


def _since_touch(track: Track) -> pd.DataFrame:
    """Absolute errors of the live estimates in contact, with the middle of their bin of time since the touch."""
    rows = track.estimates[track.estimates["touching"]]
    bins = (rows["time_s"] - rows["time_s"].min()) // _BIN_S
    moment = {"time_s": _BIN_S * (bins + 0.5), "moving": rows["moving"]}
    table = rows[list(_ERRORS)].abs().assign(split=track.split, **moment)
    return table[rows["live"] & (bins < _BINS)]


def pictures(followed: Sequence[Track], sensor: Sensor) -> list[Panel]:
    """Some recordings of one split: true and estimated path on the skin; speed and direction against time."""
    panels = []
    for track, word in zip(_chosen(followed), PICTURES, strict=False):
        touching = track.estimates[track.estimates["touching"]].set_index("time_s")
        moving, live = touching[touching["moving"]], touching[touching["live"]]
        speeds = {"true": touching["true_speed_mm_s"], "estimated": live["speed_mm_s"]}
        # A direction within 180 degrees of the truth.
        turned = live["true_direction_deg"] + live["direction_error"]
        directions = {"true": moving["true_direction_deg"], "estimated": turned}
        fastest = np.fmax(touching["true_speed_mm_s"].max(), 0.1)
        of = f"{track.name}, the {word} of {track.split} by place: true and estimated"
        panels += [
            _path(track, sensor, f"{of} path."),
            _over_time(speeds, "speed, mm/s", f"{of} speed.", ylim=(0, 1.6 * fastest)),
            _over_time(directions, "direction, deg", f"{of} direction."),
        ]
    return panels


def _chosen(followed: Sequence[Track]) -> list[Track]:
    """Best, middle and worst recording; one without any estimate is the worst."""

    def error(track: Track) -> float:
        median = summarize([track.estimates])["position"]["median"]
        return np.inf if median is None else median

    ranked = sorted(followed, key=error)
    places = np.unique(np.linspace(0, len(ranked) - 1, len(PICTURES)).round().astype(int))
    return [ranked[place] for place in places]


def _path(track: Track, sensor: Sensor, caption: str) -> Panel:
    rows, live = track.estimates, track.estimates["live"]
    wrong = rows["wrong"] | ~rows["touching"]
    parts = ((live & ~wrong, COLOURS[0], "estimated"), (live & wrong, COLOURS[1], "estimated, wrong"))

    def draw(ax: Axes) -> None:
        true = _thinned(rows[rows["touching"]])
        ax.plot(true["true_x_mm"], true["true_y_mm"], color=EDGE, linewidth=5, alpha=0.5, label="true")
        for part, colour, name in parts:
            shown = _thinned(rows[part])
            ax.plot(shown["x_mm"], shown["y_mm"], ".", color=colour, markersize=3, label=name)

    return on_skin(sensor, caption, draw, track.name)


def _over_time(values: Mapping[str, pd.Series], title: str, caption: str, **axes: Any) -> Panel:
    """values: true and estimated, by time_s."""
    series = [_thinned(each.rename("value").reset_index().assign(of=name)) for name, each in values.items()]
    look: dict[str, Any] = {"mark": ".", "colours": (EDGE, COLOURS[0]), **axes}
    return chart(pd.concat(series), "time_s", "value", "of", (title, "time, s", ""), caption, **look)


def _thinned(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.iloc[:: max(1, -(-len(rows) // _POINTS))]

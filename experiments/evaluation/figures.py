"""The report's figures: what the recordings cover, and errors by angle, place, share of the stroke and recording."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.evaluation.bounds import Verdict
from softslide.experiments.evaluation.scoring import INTERVALS, QUANTITIES, WORDS
from softslide.experiments.pages.figures import (
    COLOURS,
    EDGE,
    Panel,
    axis_marks,
    chart,
    drawn,
    intervals,
    on_cells,
    on_skin,
)
from softslide.features.card import HALF_WIDTH_SD
from softslide.pipeline.sensor import Sensor


def _log_speeds(ax: Axes) -> None:
    ax.set_xscale("log")
    axis_marks(ax.xaxis, [0.5, 1, 2, 4, 8, 13])


# The label that each recording's error of a quantity is drawn against: column, in words, and its axis, as of `chart`.
LABELS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "direction_deg": (
        *("true_direction_deg", "direction, deg"),
        {"xlim": (-12, 372), "xticks": [0, 90, 180, 270, 360]},
    ),
    "speed_percent": ("true_speed_mm_s", "speed, mm/s", {"draw": _log_speeds}),
    "offset_mm": ("true_offset_mm", "offset, mm", {}),
}
# Of `efficiency.over_bound`: key and word of each quantity.
OVER_BOUND = {"direction_deg": "direction", "log_speed": "speed", "offset_mm": "distance"}
STROKE: dict[str, Any] = {"mark": "o-", "log": True, "xlim": (0.05, 1.05)}
SEEN = "share of the stroke seen"
SECTOR_DEG = 30.0
CELL_MM = 10.0
INTERVAL = 0.9


def coverage(scored: pd.DataFrame, calibration: pd.DataFrame, sensor: Sensor) -> Panel:
    """The lines of calibration and of scored recordings on the skin. calibration: rows of a manifest."""
    end = scored[scored["stroke_fraction"] == 1.0]
    groups = [("calibration", slide_lines(calibration), EDGE)] if len(slide_lines(calibration)) else []
    for n, (split, rows) in enumerate(end.groupby("split")):
        groups.append((str(split), slide_lines(rows, "true_"), COLOURS[n % len(COLOURS)]))

    def draw(ax: Axes) -> None:
        for name, lines, colour in groups:
            ax.plot(*lines.T, color=colour, linewidth=0.9, alpha=0.7)
            ax.plot([], [], color=colour, label=f"{name} ({len(lines)})")

    text = (
        "Lines of the recordings on the skin, by split, with their number; what no line passes is not tested."
    )
    return on_skin(sensor, text, draw)


def by_angle(end: pd.DataFrame) -> list[Panel]:
    """Errors at the end of the stroke by the direction of motion, a polar panel a quantity."""
    return [_angles(*known) for known in _known(end, "true_direction_deg")]


def _angles(quantity: str, word: str, unit: str, rows: pd.DataFrame) -> Panel:
    error, direction = rows[f"{quantity}_error"], rows["true_direction_deg"]
    means = error.groupby(sectors(direction)).mean()

    def draw(ax: Axes) -> None:
        middles, width = np.deg2rad(SECTOR_DEG * means.index.to_numpy()), np.deg2rad(0.9 * SECTOR_DEG)
        ax.bar(middles, means, width=width, color=COLOURS[5], alpha=0.55, linewidth=0)
        ax.plot(np.deg2rad(direction), error, "o", markersize=3, color=COLOURS[0], alpha=0.8)
        ax.set_ylim(0, 1.15 * max(float(error.max()), 1e-9))
        ax.yaxis.set_major_locator(mpl.ticker.MaxNLocator(3))
        ax.figure.text(0.02, 0.95, f"{word}, {unit}")

    empty = ", ".join(missing_sectors(direction))
    text = f"{word.capitalize()} ({unit}) by direction of motion: bars are means of {SECTOR_DEG:g} deg, dots "
    text += f"recordings; none near {empty} deg." if empty else "recordings."
    return drawn(text, draw, 3.9, projection="polar")


def sectors(direction_deg: pd.Series) -> pd.Series:
    """Numbers of the sectors of SECTOR_DEG, the first about 0."""
    return ((direction_deg + SECTOR_DEG / 2) % 360 // SECTOR_DEG).astype(int)


def missing_sectors(direction_deg: pd.Series) -> list[str]:
    """Middles, deg, of the sectors without a direction."""
    seen = set(sectors(direction_deg))
    return [f"{SECTOR_DEG * k:g}" for k in range(int(360 / SECTOR_DEG)) if k not in seen]


def by_place(scored: pd.DataFrame, sensor: Sensor) -> list[Panel]:
    """Mean position error by where the contact is, and share of moments with a valid estimate, over the skin."""
    angle = np.deg2rad(scored["true_direction_deg"])
    way = scored["stroke_fraction"] * scored["true_travel_mm"]
    x = scored["true_start_x_mm"] + way * np.cos(angle)
    y = scored["true_start_y_mm"] + way * np.sin(angle)
    cells = pd.DataFrame(
        {"x": CELL_MM * np.floor(x / CELL_MM + 0.5), "y": CELL_MM * np.floor(y / CELL_MM + 0.5)}
    )
    cells = cells.assign(error=scored["position_mm_error"], valid=100 * scored["valid"].astype(float))
    half = np.array(sensor.chamber_mm) / 2
    means = cells[(x.abs() <= half[0]) & (y.abs() <= half[1])].groupby(["x", "y"])[["error", "valid"]].mean()
    error_text = (
        f"Mean error of the position (mm) by where the contact is, in cells of {CELL_MM:g} mm, over valid estimates at "
        "every tenth of the stroke; blank: none."
    )
    valid_text = (
        "Share of moments (%) with a valid estimate by where the contact is; early moments have none."
    )
    shown = (
        ("error", "position error, mm", error_text, "{:.2g}"),
        ("valid", "valid estimates, %", valid_text, "{:.0f}"),
    )
    known = ((means[column].dropna().to_dict(), *rest) for column, *rest in shown)
    return [on_cells(sensor, text, of, CELL_MM, form, title) for of, title, text, form in known if of]


def along_the_stroke(scored: pd.DataFrame, by: str = "split", of: str = "") -> list[Panel]:
    """Mean error of each split against the share of the stroke seen, a panel a quantity. of: which, in words."""
    panels = []
    for quantity, word, unit, rows in _known(scored, "split"):
        means = rows.groupby([by, "stroke_fraction"], as_index=False)[[f"{quantity}_error"]].mean()
        text = f"Mean {word} ({unit}) of valid estimates by the share of the stroke seen, a line a {by}{of}."
        labels = (f"mean {word}, {unit}", SEEN, "")
        panels.append(chart(means, "stroke_fraction", f"{quantity}_error", by, labels, text, **STROKE))
    return panels


def interval_coverage(scored: pd.DataFrame) -> list[Panel]:
    """Share of labels in their 90 % interval by split, with the range that the number of recordings leaves."""
    panels = []
    for column, word in zip(INTERVALS, WORDS.values(), strict=True):
        rows = scored[scored[f"{column}_covered"].notna()]
        if rows.empty:
            continue
        groups = rows.groupby("split").agg(share=(f"{column}_covered", "mean"), n=("recording", "nunique"))
        middle, low, high = 100 * np.array([(s, *wilson(s, n)) for s, n in groups.to_numpy()]).T
        names = [f"{split} ({n})" for split, n in groups["n"].items()]
        table = pd.DataFrame({"split": names, "of": "", "middle": middle, "low": low, "high": high})
        text = (
            f"Share of labels within the 90 % interval of the {word}, by split with the number of recordings; bars: "
            "what chance leaves open with so many recordings."
        )
        labels = (word, "labels within the interval, %")
        look: dict[str, Any] = {"line": 100 * INTERVAL, "xlim": (-3, 103)}
        panels.append(intervals(table, "split", "of", labels, text, **look))
    return panels


def wilson(share: float, count: int) -> tuple[float, float]:
    """90 % interval of a share seen in so many independent trials (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    spread = HALF_WIDTH_SD**2 / count
    middle = (share + spread / 2) / (1 + spread)
    half = np.sqrt(spread * share * (1 - share) + spread**2 / 4) / (1 + spread)
    return float(middle - half), float(middle + half)


def recording_by_recording(end: pd.DataFrame, verdicts: Sequence[Verdict]) -> list[Panel]:
    """Error of each recording at the end of its stroke against its label, with the article's bound."""
    limits = {v.bound.quantity: v.bound.limit for v in reversed(verdicts)}
    panels = []
    for quantity, word, unit, rows in _known(end):
        (label, title, axis), limit = LABELS[quantity], limits.get(quantity)
        text = f"{word.capitalize()} ({unit}) of each of {len(rows)} recordings at the end of the stroke"
        text += f"; dashed: the article's bound, {limit:g} {unit}." if limit else "."
        labels, error, rows = (f"{word}, {unit}", title, ""), f"{quantity}_error", rows.sort_values("split")
        panels.append(chart(rows, label, error, "split", labels, text, limit=limit, log=True, **axis))
    return panels


def over_bound(found: Mapping[str, Mapping[str, Mapping[str, float]]]) -> list[Panel]:
    """Rms error over the Cramer-Rao bound against the share of the stroke seen, a line a split, a panel a quantity.

    found: of `efficiency.over_bound`.
    """
    rows = [
        {"split": split, "share": float(share), **row}
        for split, strokes in found.items()
        for share, row in strokes.items()
    ]
    if not rows:
        return []
    table = pd.DataFrame(rows)
    counts = table.groupby("split", sort=False)["recordings"].agg(["min", "max"]).itertuples()
    behind = ", ".join(
        f"{split} {low:g}" + (f" to {high:g}" if high > low else "") for split, low, high in counts
    )
    panels = []
    for quantity, word in OVER_BOUND.items():
        text = (
            f"Rms error of the {word} over its Cramer-Rao bound by the share of the stroke seen, a line a split; "
            f"dashed: the bound. Recordings behind each point: {behind}."
        )
        labels = (f"{word}: rms error / bound", SEEN, "")
        panels.append(chart(table, "share", quantity, "split", labels, text, limit=1.0, **STROKE))
    return panels


def paths(scored: pd.DataFrame, by: str, sensor: Sensor, caption: str, title: str = "") -> Panel:
    """True lines of recordings, and the places estimated at each tenth of the stroke. by: a column that names them."""

    def draw(ax: Axes) -> None:
        for n, (name, rows) in enumerate(scored.groupby(by, sort=False)):
            for line in slide_lines(rows.iloc[-1:], "true_"):
                ax.plot(*line.T, color=EDGE, linewidth=5, alpha=0.5, label="" if n else "true")
            x, y = rows.loc[rows["valid"].astype(bool), ["x_mm", "y_mm"]].to_numpy(float).T
            ax.plot(x, y, "o-", markersize=3, linewidth=1, color=COLOURS[n % len(COLOURS)], label=str(name))

    return on_skin(sensor, caption, draw, title)


def outputs(
    table: pd.DataFrame, name: str, channels: Sequence[str], motion_s: np.ndarray, unit: str = "V"
) -> Panel:
    """One recording's subtracted outputs over time, with the time of the motion shaded. table: of `traces.trace`.

    unit: of the outputs; volts are shown in mV.
    """
    factor, shown = (1000, "mV") if unit == "V" else (1, unit)
    thin = table.iloc[:: max(1, len(table) // 300)]
    long = thin.melt("time_s", list(channels), "channel", "output")
    long["output"] *= factor
    text = f"{name}: outputs less the static output; shaded: the motion."

    def draw(ax: Axes) -> None:
        if np.isfinite(motion_s).all():
            ax.axvspan(motion_s[0], motion_s[1], color=EDGE, alpha=0.12, linewidth=0)

    labels = (name, "time, s", f"subtracted output, {shown}")
    return chart(long, "time_s", "output", "channel", labels, text, mark="-", draw=draw)


def _known(scored: pd.DataFrame, label: str = "") -> Iterator[tuple[str, str, str, pd.DataFrame]]:
    """Each quantity, its error in a word and its unit, and the rows with an error and a label, if any.

    label: by default the quantity's own.
    """
    for quantity, (own, *_) in LABELS.items():
        rows = scored.dropna(subset=[f"{quantity}_error", label or own])
        if len(rows):
            yield quantity, f"{WORDS[quantity]} error", QUANTITIES[quantity], rows


def slide_lines(rows: pd.DataFrame, prefix: str = "") -> np.ndarray:
    """(n, 2, 2) mm: first and last place, x and y, of each line; rows without start, direction or travel have none."""
    columns = [prefix + name for name in ("start_x_mm", "start_y_mm", "direction_deg", "travel_mm")]
    x, y, angle, travel = rows[columns].dropna().to_numpy(float).T
    heading = np.column_stack([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    start = np.column_stack([x, y])
    return np.stack([start, start + travel[:, None] * heading], axis=1)

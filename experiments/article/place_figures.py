"""Figures 23 to 25: where the method works, and trajectories."""

import matplotlib as mpl
import numpy as np
import pandas as pd

from experiments.article.axis_slides import KINDS
from experiments.article.estimate_figures import DISTANCE_LIMIT, SPEED_LIMIT
from experiments.article.scoring import Scored, at_end
from experiments.article.section import Section
from experiments.article.slide_figures import Whole
from experiments.pages.figures import COLOURS, INK, Panel, inline, panel

ARTICLE_MM = ((0.0, 17.5), (0.0, 25.0))  # detectable area, by axis
BIN_MM = 2.5
DELAY_MM = (18.0, 17.5, 20.5, 21.5)  # by kind


def areas(best: Scored, chamber_mm: tuple[float, float], board_mm: tuple[float, float]) -> Section:
    """Figure 23: where the method detects and where it locates, as measured."""
    table = pd.concat([area_table(at_end(best.new, axis)).assign(axis="XY"[axis]) for axis in (0, 1)])
    if table.empty:
        return Section("23", "Detectable and effective area", "", missing="No slide along x or y to test on.")
    panels = [
        _area_panel(table, axis, chamber_mm, board_mm) for axis in (0, 1) if "XY"[axis] in set(table["axis"])
    ]
    told = [f"{letter}-slides: {_reach(rows)}" for letter, rows in table.groupby("axis")]
    return Section(
        "23",
        "Detectable and effective area, as measured",
        "Detectable: |y| <= 17.5 mm (X) and 0 <= x <= 25 mm (Y), direction right and speed within 8 %. "
        "Effective: 5 <= |y| "
        "<= 17.5 mm and 10 <= x <= 22.5 mm, distance within 15 %.",
        "At its best, on " + best.on + "; answered slides alone. " + " ".join(told),
        tuple(panels),
        table,
    )


def trajectories(whole: Whole, best: Scored, axis: int) -> Section:
    """Figures 24 and 25: actual and estimated place over time."""
    letter, figures = "XY"[axis], ("24", "25")[axis]
    title = f"Trajectories, {letter}-slides"
    article = (
        "(v t, y) and (x, v t) within 15 % once the extremes have passed, after 18 to 21.5 mm of the 50."
    )
    panels, tables = [], []
    for kind in (axis, axis + 2):
        rows = best.new[(best.new["kind"] == kind) & best.new["valid"]]
        ends = rows[rows["stroke_fraction"] == 1.0]
        if ends.empty:
            continue
        off = (ends["distance_mm"] - 12.5).abs() + (ends["true_speed_mm_s"] - 2.0).abs()
        name = str(ends["recording"].iloc[int(off.to_numpy().argmin())])
        shown = best.new[best.new["recording"] == name]
        panels.append(_trajectory(shown, kind))
        columns = ["recording", "stroke_fraction", "travelled_mm", "x_mm", "y_mm", "position_mm_error"]
        tables.append(shown[[*columns, "position_percent_error", "valid"]].assign(kind=KINDS[kind]))
    if not panels:
        return Section(figures, title, article, missing=f"No {letter}-slide is answered.")
    return Section(figures, title, article, _delay_sentence(whole, axis), tuple(panels), pd.concat(tables))


def area_table(end: pd.DataFrame) -> pd.DataFrame:
    """By bins of the distance: slides, share answered, share of these with the right direction, largest errors."""
    rows = []
    bins = (end["distance_mm"] / BIN_MM).round().astype(int)
    for number, part in end.groupby(bins):
        answered = part[part["valid"]]
        rows.append(
            {
                "distance_mm": BIN_MM * number,
                "slides": len(part),
                "answered": len(answered),
                "direction_right": int((answered["direction_deg_error"] < 45).sum()),
                "speed_percent_max": answered["speed_percent_error"].max(),
                "distance_percent_max": answered["offset_percent_error"].max(),
            }
        )
    table = pd.DataFrame(rows)
    if len(table):
        right = (table["answered"] > 0) & (table["direction_right"] == table["answered"])
        table["detectable"] = right & (table["speed_percent_max"] < SPEED_LIMIT)
        table["effective"] = table["detectable"] & (table["distance_percent_max"] < DISTANCE_LIMIT)
    return table


def delays_mm(whole: Whole) -> pd.DataFrame:
    """Median way past the edge at which the first extreme comes, by kind: `kind`, `first_mm`, `article_mm`."""
    first = whole.table[["low_mm", "high_mm"]].min(axis=1)
    median = first[whole.table["distance_mm"] <= 17.5].groupby(whole.table["kind"]).median()
    rows = [
        {"kind": KINDS[k], "first_mm": median[k], "article_mm": DELAY_MM[k]}
        for k in range(4)
        if k in median.index
    ]
    return pd.DataFrame(rows)


def _area_panel(
    table: pd.DataFrame, axis: int, chamber_mm: tuple[float, float], board_mm: tuple[float, float]
) -> Panel:
    rows = table[table["axis"] == "XY"[axis]]
    x, y = np.array(chamber_mm) / 2
    across = (y, x)[axis]
    with panel(4.3, below=0.2) as (figure, ax):
        ax.add_patch(mpl.patches.Rectangle((-x, -y), 2 * x, 2 * y, fill=False, edgecolor=INK))
        centre = board_mm[1 - axis]
        for row in rows.to_dict("records"):
            colour = COLOURS[2] if row["effective"] else COLOURS[5] if row["detectable"] else COLOURS[1]
            for place in {centre + row["distance_mm"], centre - row["distance_mm"]}:
                low, high = max(place - BIN_MM / 2, -across), min(place + BIN_MM / 2, across)
                if low < high:
                    corner = (-x, low) if axis == 0 else (low, -y)
                    size = (2 * x, high - low) if axis == 0 else (high - low, 2 * y)
                    ax.add_patch(
                        mpl.patches.Rectangle(corner, *size, facecolor=colour, alpha=0.45, linewidth=0)
                    )
        for reach in (-ARTICLE_MM[axis][1], ARTICLE_MM[axis][1]):
            line = ax.axhline if axis == 0 else ax.axvline
            line(centre + reach, color=INK, linestyle="--", linewidth=1)
        ax.plot(*board_mm, "s", color=INK, markersize=6)
        patches = [
            mpl.patches.Patch(facecolor=COLOURS[n], alpha=0.45, label=name)
            for n, name in ((2, "effective"), (5, "detectable"), (1, "neither"))
        ]
        figure.legend(handles=patches, loc="lower center", ncols=3, fontsize=8)
        ax.set(
            xlim=(-x - 2, x + 2),
            ylim=(-y - 2, y + 2),
            aspect="equal",
            xlabel="x, mm",
            ylabel="y, mm",
            title=f"{'XY'[axis]}-slides",
        )
        text = (
            f"Measured area of {'XY'[axis]}-slides by the distance of the line, on both sides alike; dashed: "
            "the article's detectable "
            "area; blank: no slide."
        )
        return Panel(inline(figure, text), text)


def _reach(rows: pd.DataFrame) -> str:
    def told(column: str) -> str:
        good = rows.loc[rows[column], "distance_mm"]
        return ", ".join(f"{d:g}" for d in good) if len(good) else "none"

    return (
        f"detectable at {told('detectable')} mm, effective at {told('effective')} mm (bins of {BIN_MM:g} mm)."
    )


def _trajectory(shown: pd.DataFrame, kind: int) -> Panel:
    axis = kind % 2
    said, true = ("x_mm", "y_mm")[axis], ("true_start_x_mm", "true_start_y_mm")[axis]
    sense = 1 if kind < 2 else -1
    rows = shown[shown["valid"]]
    path = shown[true] + sense * shown["stroke_fraction"] * shown["true_travel_mm"]
    name = str(shown["recording"].iloc[0])
    time = shown["stroke_fraction"] * shown["true_travel_mm"] / shown["true_speed_mm_s"]
    with panel() as (figure, ax):
        ax.plot(time, path, color=COLOURS[1], linewidth=2, label="actual")
        ax.plot(time[rows.index], rows[said], "o-", markersize=4, color=COLOURS[0], label="estimated")
        ax.set(xlabel="time since the motion began, s", ylabel=f"{'xy'[axis]}, mm", title=KINDS[kind])
        ax.legend()
        text = (
            f"{name}: actual and estimated place of the contact in a {KINDS[kind]} slide; no estimate before "
            "the extremes."
        )
        return Panel(inline(figure, text), text)


def _delay_sentence(whole: Whole, axis: int) -> str:
    table = delays_mm(whole)
    ours = table[table["kind"].str.startswith("XY"[axis])]
    return (
        "The first extreme comes "
        + ", ".join(
            f"{row.first_mm:.1f} mm past the edge in {row.kind} slides (the article: {row.article_mm:g})"
            for row in ours.itertuples()
        )
        + "; medians."
    )

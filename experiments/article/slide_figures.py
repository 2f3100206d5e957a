"""Figures 14 to 16: outputs of each kind of slide, and how their extremes go with distance and speed."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.article.axis_slides import EXTREMES, AxisSlides
from softslide.experiments.article.section import Section
from softslide.experiments.evaluation.scoring import AXES
from softslide.experiments.evaluation.traces import trace
from softslide.experiments.pages.figures import EDGE, LABEL, Panel, chart
from softslide.models.classical.interpolation import DETECTABLE_MM, slide_direction

# The article's six kinds: name, index into AXES, sign of the offset seen along x or y (0: any), zones passed.
CASES = (
    ("X-slide, y < 0, forward", 0, -1, (1, 2)),
    ("X-slide, y < 0, backward", 2, -1, (2, 1)),
    ("X-slide, y > 0, forward", 0, 1, (3, 4)),
    ("X-slide, y > 0, backward", 2, 1, (4, 3)),
    ("Y-slide, x < 0, forward", 1, -1, (1, 3)),
    ("Y-slide, x < 0, backward", 3, -1, (3, 1)),
)
SHOWN_MM, SHOWN_MM_S = 10.0, 2.0  # distance and speed that a shown slide is to be near
DISTANCES_MM = (5.0, 10.0, 15.0, 22.5)  # that figures 15a and 16a show
SPEEDS_MM_S = (0.5, 1.0, 2.0, 4.0)  # and 15b and 16b
DELAY_MM = (18.0, 17.5, 20.5, 21.5)  # the article's, by kind
PAST_EDGE, SINCE_EDGE = "way past the chamber's edge, mm", "time since the chamber's edge, s"
FROM_BOARD = "distance from the accelerometer, mm"
POINTS = 250  # of a trace: more are not seen


def zones(whole: AxisSlides) -> Section:
    """Figure 14: V_x and V_y of each kind of slide, with the contact zones."""
    rows, panels, tables, lacking = whole.table, [], [], []
    for case in CASES:
        title, kind, side, _ = case
        some = rows[(rows["kind"] == kind) & (np.sign(rows["place_mm"]) == side)]
        if some.empty:
            lacking.append(title)
            continue
        row = nearest(some, SHOWN_MM, SHOWN_MM_S)
        shown = _shown(whole, row).assign(case=title, recording=row["recording"])
        panels.append(_zone_panel(case, row, shown))
        tables.append(shown)
    share = sign_share(whole)
    return Section(
        "14",
        "Outputs of each kind of slide, with the contact zones",
        "X-slides change the sign of V_x and keep V_y's, Y-slides the other way round; the order separates forward "
        "from backward.",
        f"So in {share.sum()} of {len(share)} slides ({100 * share.mean():.0f} %) in the article's detectable area.",
        tuple(panels),
        pd.concat(tables, ignore_index=True) if tables else pd.DataFrame(),
        f"No recording of: {'; '.join(lacking)}." if lacking else "",
    )


def _zone_panel(case: tuple, row: pd.Series, shown: pd.DataFrame) -> Panel:
    title, *_, (first, second) = case
    foot = -row["edge_mm"]
    look: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}

    def draw(ax: Axes) -> None:
        ax.axvspan(shown["past_edge_mm"].min(), foot, color=EDGE, alpha=0.12, linewidth=0)
        for zone, side, align in ((first, -6, "right"), (second, 6, "left")):
            ax.annotate(f"zone {zone}", (foot, 1.0), (side, -2), ha=align, va="top", color=LABEL, **look)
        ax.axhline(0, color=EDGE, linewidth=1)
        ax.margins(y=0.15)

    text = (
        f"{row['recording']}: {title}, {row['distance_mm']:.1f} mm from the accelerometer, {row['speed_mm_s']:.2g} "
        "mm/s; the shading ends where the contact passes the accelerometer."
    )
    mv = 1000 * shown.rename(columns={"vx": "V_x", "vy": "V_y"}).set_index("past_edge_mm")[["V_x", "V_y"]]
    long = mv.melt(var_name="output", value_name="mv", ignore_index=False).reset_index()
    labels = (title, PAST_EDGE, "subtracted output, mV")
    return chart(long, "past_edge_mm", "mv", "output", labels, text, mark="-", draw=draw)


def extremes(whole: AxisSlides, axis: int) -> Section:
    """Figures 15 (axis 0, X-slides) and 16 (axis 1, Y-slides): extremes against distance and speed."""
    letter, number = "XY"[axis], ("15", "16")[axis]
    rows = whole.table[whole.table["kind"] % 2 == axis]
    forward = rows[rows["kind"] == axis]
    title = f"{letter}-slides: extremes of V_{letter.lower()} against distance and speed"
    says = "The values of the extremes depend on the distance alone, their moments on the speed alone."
    if forward.empty:
        return Section(number, title, says, missing=f"No {AXES[axis]} slide in this folder.")
    (low, high), drift = extreme_place(forward).values(), speed_effect(forward)
    here = (
        f"In {AXES[axis]} slides the minimum comes {low[0]:.1f} to {low[1]:.1f} mm past the chamber's edge and the "
        f"maximum {high[0]:.1f} to {high[1]:.1f} mm, by the distance of the line: a moment is not the speed's alone."
    )
    if drift is not None:
        here += f" On one line, extremes of different speeds differ by {drift:.1f} % (median range)."
    columns = ["recording", "split", "kind", "speed_mm_s", "distance_mm", "place_mm", "trigger_mm"]
    columns += [f"{name}_{unit}" for name in EXTREMES for unit in ("v", "s", "mm")]
    table = rows[columns].assign(kind=rows["kind"].map(dict(enumerate(AXES))))
    return Section(number, title, says, here, tuple(_traces(whole, forward, letter)), table)


def _traces(whole: AxisSlides, rows: pd.DataFrame, letter: str) -> list[Panel]:
    """Outputs at several distances against the way, and at several speeds against the time."""
    output, panels = f"v{letter.lower()}", []
    lines, speeds = [(d, SHOWN_MM_S) for d in DISTANCES_MM], [(SHOWN_MM, v) for v in SPEEDS_MM_S]
    for of, x, label, words, wanted in (
        ("distance", "past_edge_mm", PAST_EDGE, "farther lines give smaller", lines),
        ("speed", "time_s", SINCE_EDGE, "faster slides have earlier", speeds),
    ):
        chosen = pd.DataFrame([nearest(rows, *each) for each in wanted]).drop_duplicates("recording")
        shown = pd.concat(
            _shown(whole, row).assign(slide=f"{row['distance_mm']:.1f} mm, {row['speed_mm_s']:.2g} mm/s")
            for _, row in chosen.iterrows()
        )
        shown["mv"] = 1000 * shown[output]
        text = f"V_{output[1]} in {letter} forward slides at several {of}s: {words} extremes."
        labels = (f"by {of}", label, f"V_{output[1]}, mV")
        panels.append(chart(shown, x, "mv", "slide", labels, text, mark="-"))
    return panels


def _shown(whole: AxisSlides, row: pd.Series) -> pd.DataFrame:
    """One slide's trace over the skin: past_edge_mm, time_s since the edge, vx, vy; thinned."""
    folder, name = whole.folder, str(row["recording"])
    label, (x, y) = folder.manifest.loc[name], folder.sensor.reference_mm
    table = trace(folder, name, whole.conditioning)
    angle = np.deg2rad(label["direction_deg"])
    start = np.cos(angle) * (label["start_x_mm"] - x) + np.sin(angle) * (label["start_y_mm"] - y)
    past = table["travelled_mm"] + start - row["edge_mm"]
    moving = (table["travelled_mm"] > 0) & (table["travelled_mm"] < label["travel_mm"])
    shown = pd.DataFrame({"past_edge_mm": past, "time_s": past / row["speed_mm_s"]})
    shown[["vx", "vy"]] = table.iloc[:, :2]
    return shown[moving].iloc[:: max(1, moving.sum() // POINTS)].reset_index(drop=True)


def sign_share(whole: AxisSlides) -> pd.Series:
    """For each slide in the article's detectable area whether its signs show its direction."""
    found = slide_direction(whole.features)
    right = found[np.arange(len(found)), whole.table["kind"]]
    return pd.Series(right)[(whole.table["distance_mm"] <= DETECTABLE_MM[whole.table["kind"]]).to_numpy()]


def extreme_place(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Lowest and highest mean way (mm) past the edge, over lines, at which each extreme comes."""
    near = rows[rows["distance_mm"] <= 17.5]
    lines = (near if len(near) else rows).groupby(rows["distance_mm"].round(1))
    means = {name: lines[f"{name}_mm"].mean() for name in EXTREMES}
    return {name: (float(mean.min()), float(mean.max())) for name, mean in means.items()}


def speed_effect(rows: pd.DataFrame) -> float | None:
    """Range of the minimum over speeds of one line, % of it, median over lines; None without any."""
    lines = rows.dropna(subset=["low_v"]).groupby(rows["place_mm"].round(1))["low_v"]
    spread = lines.agg(lambda v: 100 * np.ptp(v) / np.abs(v.mean()))[lines.size() > 1]
    return float(spread.median()) if len(spread) else None


def nearest(rows: pd.DataFrame, distance_mm: float, speed_mm_s: float) -> pd.Series:
    """The slide nearest to a distance and, of those, to a speed."""
    off = (rows["distance_mm"] - distance_mm).abs() / 2.5 + np.abs(np.log(rows["speed_mm_s"] / speed_mm_s))
    return rows.loc[off.idxmin()]


def delays_mm(whole: AxisSlides) -> pd.DataFrame:
    """Median way past the edge at which the first extreme comes, by kind: `kind`, `first_mm`, `article_mm`."""
    first = whole.table[["low_mm", "high_mm"]].min(axis=1)
    median = first[whole.table["distance_mm"] <= 17.5].groupby(whole.table["kind"]).median()
    rows = [(AXES[k], median[k], DELAY_MM[k]) for k in range(4) if k in median.index]
    return pd.DataFrame(rows, columns=["kind", "first_mm", "article_mm"])

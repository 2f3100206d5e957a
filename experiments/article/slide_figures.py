"""Figures 14 to 16: outputs of each kind of slide, and how their extremes go with distance and speed."""

from collections.abc import Iterable
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.article.axis_slides import KINDS, AxisSlides
from experiments.article.section import Section
from experiments.evaluation.traces import trace
from experiments.pages.figures import COLOURS, EDGE, LABEL, Panel, inline, panel
from models.classical.interpolation import abscissas, slide_direction

# The article's six kinds: name, index into KINDS, sign of the offset seen along x or y (0: any), zones passed.
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
POINTS = 250  # of a trace: more are not seen


@dataclass(frozen=True)
class Whole:
    """One row a slide: `AxisSlides.table` with `place_mm` (signed, from the accelerometer, across the line) and the
    output along the motion: `low_v`, `high_v`, and the moments of both, `low_s`, `high_s` after the trigger and
    `low_mm`, `high_mm` past the chamber's edge; NaN where the extreme has not passed."""

    slides: AxisSlides
    table: pd.DataFrame


def whole_slides(slides: AxisSlides) -> Whole:
    """The slides at the end of their stroke."""
    whole = slides.whole
    kind = whole.table["kind"].to_numpy()
    rows = np.arange(len(whole))
    values, passed = abscissas(whole.features, "distance")
    moments, _ = abscissas(whole.features, "speed", "quadratic")
    # To the left of +x lies +y, to the left of +y lies -x.
    across = np.array([1.0, -1.0, -1.0, 1.0])[kind]
    table = whole.table.assign(place_mm=across * whole.table["offset_mm"])
    for e, name in enumerate(("low", "high")):
        seen = passed[rows, kind, e]
        table[f"{name}_v"] = np.where(seen, values[rows, kind, e], np.nan)
        table[f"{name}_s"] = np.where(seen, moments[rows, kind, e], np.nan)
        table[f"{name}_mm"] = table["trigger_mm"] + table["speed_mm_s"] * table[f"{name}_s"]
    return Whole(whole, table)


def zones(whole: Whole) -> Section:
    """Figure 14: V_x and V_y of each kind of slide, with the contact zones."""
    panels, tables = [], []
    for title, kind, place, (first, second) in CASES:
        rows = whole.table[(whole.table["kind"] == kind) & (np.sign(whole.table["place_mm"]) == place)]
        if rows.empty:
            continue
        row = nearest(rows, SHOWN_MM, SHOWN_MM_S)
        shown = _shown(whole, row)
        foot = -row["edge_mm"]
        with panel() as (figure, ax):
            for n, axis in enumerate("xy"):
                ax.plot(shown["past_edge_mm"], 1000 * shown[f"v{axis}"], color=COLOURS[n], label=f"V_{axis}")
            ax.axvspan(shown["past_edge_mm"].min(), foot, color=EDGE, alpha=0.12, linewidth=0)
            ax.axhline(0, color=EDGE, linewidth=1)
            for zone, side, align in ((first, -6, "right"), (second, 6, "left")):
                ax.annotate(
                    f"zone {zone}",
                    (foot, 1.0),
                    (side, -2),
                    xycoords=("data", "axes fraction"),
                    textcoords="offset points",
                    ha=align,
                    va="top",
                    color=LABEL,
                )
            ax.margins(y=0.15)
            ax.set(xlabel="way past the chamber's edge, mm", ylabel="subtracted output, mV", title=title)
            ax.legend(loc="lower right")
            text = (
                f"{row['recording']}: {title}, {row['distance_mm']:.1f} mm from the accelerometer, "
                f"{row['speed_mm_s']:.2g} "
                "mm/s; the shading ends where the contact passes the accelerometer."
            )
            panels.append(Panel(inline(figure, text), text))
        tables.append(shown.assign(case=title, recording=row["recording"]))
    share = sign_share(whole)
    return Section(
        "14",
        "Outputs of each kind of slide, with the contact zones",
        "X-slides change the sign of V_x and keep V_y's, Y-slides the other way round; the order tells forward from "
        "backward.",
        f"So it is in {share.sum()} of {len(share)} slides ({100 * share.mean():.0f} %) in the article's "
        "detectable area.",
        tuple(panels),
        pd.concat(tables, ignore_index=True) if tables else None,
        _lacking([case[0] for case in CASES if not any(case[0] in p.caption for p in panels)]),
    )


def extremes(whole: Whole, axis: int) -> Section:
    """Figures 15 (axis 0, X-slides) and 16 (axis 1, Y-slides): extremes against distance and speed."""
    letter = "XY"[axis]
    rows = whole.table[whole.table["kind"] % 2 == axis]
    forward = rows[rows["kind"] == axis]
    figures = ("15", "16")[axis]
    title = f"{letter}-slides: extremes of V_{letter.lower()} against distance and speed"
    article = "The values of the extremes depend on the distance alone, their moments on the speed alone."
    if forward.empty:
        return Section(figures, title, article, missing=f"No {KINDS[axis]} slide in this folder.")
    panels = [
        _by_distance(whole, forward, letter),
        _by_speed(whole, forward, letter),
        _values(rows, letter),
        _moments(rows, letter),
    ]
    place, drift = extreme_place(forward), speed_effect(forward)
    here = (
        f"In {KINDS[axis]} slides the minimum comes {place['low'][0]:.1f} to {place['low'][1]:.1f} mm past "
        "the chamber's edge and "
        f"the maximum {place['high'][0]:.1f} to {place['high'][1]:.1f} mm, by the distance of the line, so "
        "that a moment is not "
        f"the speed's alone."
    )
    if drift is not None:
        here += f" On one line, extremes of different speeds differ by {drift:.1f} % (median range)."
    columns = ["recording", "split", "kind", "speed_mm_s", "distance_mm", "place_mm", "trigger_mm"]
    columns += [f"{name}_{unit}" for name in ("low", "high") for unit in ("v", "s", "mm")]
    table = rows[columns].assign(kind=rows["kind"].map(dict(enumerate(KINDS))))
    return Section(figures, title, article, here, tuple(panels), table)


def sign_share(whole: Whole) -> pd.Series:
    """For each slide in the article's detectable area whether its signs tell its direction."""
    found = slide_direction(whole.slides.features)
    right = found[np.arange(len(found)), whole.table["kind"]]
    limit = np.where(whole.table["kind"] % 2 == 0, 17.5, 25.0)
    return pd.Series(right)[(whole.table["distance_mm"] <= limit).to_numpy()]


def extreme_place(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Lowest and highest mean way (mm) past the edge, over lines, at which each extreme comes."""
    near = rows[rows["distance_mm"] <= 17.5]
    lines = (near if len(near) else rows).groupby(rows["distance_mm"].round(1))
    return {
        name: (float(lines[f"{name}_mm"].mean().min()), float(lines[f"{name}_mm"].mean().max()))
        for name in ("low", "high")
    }


def speed_effect(rows: pd.DataFrame) -> float | None:
    """Range of the minimum over speeds of one line, % of it, median over lines; None without any."""
    lines = rows.dropna(subset=["low_v"]).groupby(rows["place_mm"].round(1))["low_v"]
    several = lines.filter(lambda values: len(values) > 1).index
    if not len(several):
        return None
    part = rows.loc[several]
    spread = part.groupby(part["place_mm"].round(1))["low_v"].agg(
        lambda v: 100 * np.ptp(v) / np.abs(v.mean())
    )
    return float(spread.median())


def nearest(rows: pd.DataFrame, distance_mm: float, speed_mm_s: float) -> pd.Series:
    """The slide nearest to a distance and, of those, to a speed."""
    off = (rows["distance_mm"] - distance_mm).abs() / 2.5 + np.abs(np.log(rows["speed_mm_s"] / speed_mm_s))
    return rows.loc[off.idxmin()]


def _lacking(cases: list[str]) -> str:
    return f"No recording of: {'; '.join(cases)}." if cases else ""


def _shown(whole: Whole, row: pd.Series) -> pd.DataFrame:
    """One slide's trace over the skin: past_edge_mm, time_s since the edge, vx, vy; thinned."""
    return _trace(whole, str(row["recording"]), float(row["edge_mm"]), float(row["speed_mm_s"]))


def _trace(whole: Whole, name: str, edge_mm: float, speed: float) -> pd.DataFrame:
    folder = whole.slides.folder
    table = trace(folder, name, whole.slides.conditioning)
    label = folder.manifest.loc[name]
    angle = np.deg2rad(label["direction_deg"])
    x, y = folder.sensor.reference_mm
    start = np.cos(angle) * (label["start_x_mm"] - x) + np.sin(angle) * (label["start_y_mm"] - y)
    past = table["travelled_mm"] + start - edge_mm
    moving = (table["travelled_mm"] > 0) & (table["travelled_mm"] < label["travel_mm"])
    columns = {"past_edge_mm": past, "time_s": past / speed}
    columns |= {axis: table.iloc[:, n] for n, axis in enumerate(("vx", "vy"))}
    shown = pd.DataFrame(columns)[moving]
    return shown.iloc[:: max(1, len(shown) // POINTS)].reset_index(drop=True)


def _draw(
    ax: Axes,
    whole: Whole,
    rows: pd.DataFrame,
    names: Iterable[str],
    letter: str,
    across: str,
    label: str,
) -> None:
    """The output of these slides against a column of what is shown of them. label: with their rows' numbers."""
    for n, name in enumerate(names):
        row = rows[rows["recording"] == name].iloc[0]
        shown = _shown(whole, row)
        volts = 1000 * shown[f"v{letter.lower()}"]
        ax.plot(shown[across], volts, color=COLOURS[n], label=label.format(**row))


def _by_distance(whole: Whole, rows: pd.DataFrame, letter: str) -> Panel:
    chosen = {nearest(rows, d, SHOWN_MM_S)["recording"]: d for d in DISTANCES_MM}
    with panel() as (figure, ax):
        _draw(ax, whole, rows, chosen, letter, "past_edge_mm", "{distance_mm:.1f} mm")
        ax.set(
            xlabel="way past the chamber's edge, mm", ylabel=f"V_{letter.lower()}, mV", title="by distance"
        )
        ax.legend()
        text = (
            f"V_{letter.lower()} in {letter} forward slides at several distances: farther lines give smaller "
            "extremes."
        )
        return Panel(inline(figure, text), text)


def _by_speed(whole: Whole, rows: pd.DataFrame, letter: str) -> Panel:
    chosen = {nearest(rows, SHOWN_MM, v)["recording"]: v for v in SPEEDS_MM_S}
    with panel() as (figure, ax):
        _draw(ax, whole, rows, chosen, letter, "time_s", "{speed_mm_s:.2g} mm/s, {distance_mm:.1f} mm")
        ax.set(xlabel="time since the chamber's edge, s", ylabel=f"V_{letter.lower()}, mV", title="by speed")
        ax.legend(fontsize=8)
        text = f"V_{letter.lower()} in {letter} forward slides at several speeds: faster slides have earlier extremes."
        return Panel(inline(figure, text), text)


def _values(rows: pd.DataFrame, letter: str) -> Panel:
    with panel() as (figure, ax):
        for n, (name, word) in enumerate((("low", "minimum"), ("high", "maximum"))):
            ax.plot(
                rows["distance_mm"],
                1000 * rows[f"{name}_v"],
                "o",
                markersize=3,
                alpha=0.7,
                color=COLOURS[n],
                label=word,
            )
        ax.set(
            xlabel="distance from the accelerometer, mm",
            ylabel=f"V_{letter.lower()}, mV",
            title="values of the extremes",
        )
        ax.legend()
        text = (
            f"Extreme values of V_{letter.lower()} in all {len(rows)} {letter}-slides against the distance of "
            "the line."
        )
        return Panel(inline(figure, text), text)


def _moments(rows: pd.DataFrame, letter: str) -> Panel:
    with panel() as (figure, ax):
        for n, (name, word) in enumerate((("low", "minimum"), ("high", "maximum"))):
            ax.plot(
                rows["speed_mm_s"],
                rows[f"{name}_mm"] / rows["speed_mm_s"],
                "o",
                markersize=3,
                alpha=0.7,
                color=COLOURS[n],
                label=word,
            )
        ax.set(
            xlabel="speed, mm/s", ylabel="time since the chamber's edge, s", title="moments of the extremes"
        )
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(mpl.ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_locator(mpl.ticker.NullLocator())
        ax.legend()
        text = f"Moments of the extremes of V_{letter.lower()} in all {len(rows)} {letter}-slides against the speed."
        return Panel(inline(figure, text), text)

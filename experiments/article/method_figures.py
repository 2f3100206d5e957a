"""Figures 17 to 25: the interpolation, what it estimates, where it works, and trajectories."""

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.article.axis_slides import KINDS
from experiments.article.method import LEAST_SPEED_MM_S, Method
from experiments.article.scoring import Scored
from experiments.article.section import Section
from experiments.article.slide_figures import Whole
from experiments.pages.figures import COLOURS, EDGE, INK, Panel, inline, log_with_zero, panel
from models.classical.interpolation import Polynomials

# The one fit that the article still shows, of X-sliding: v in mm/s of t_max in s, coefficients in rising powers.
PUBLISHED_CHI = (7.4336, -0.4331, 0.008)
ARTICLE_MM = ((0.0, 17.5), (0.0, 25.0))  # detectable area, by axis
ARTICLE_EFFECTIVE_MM = ((5.0, 17.5), (10.0, 22.5))
SPEED_LIMIT, DISTANCE_LIMIT = 8.0, 15.0  # %
BIN_MM = 2.5
DELAY_MM = (18.0, 17.5, 20.5, 21.5)  # by kind
WORDS = ("minimum", "maximum")


def interpolation(whole: Whole, published: Scored, best: Scored, kind: int) -> Section:
    """Figures 17 to 20: the curves of one kind of slide, with the calibration slides that they are fitted to."""
    # In the article: X forward, X backward, Y forward, Y backward.
    number = (17, 19, 18, 20)[kind]
    rows = whole.table[
        (whole.table["kind"] == kind) & whole.table["split"].str.startswith(("calibration", "train"))
    ]
    title = f"Interpolation of speed and distance, {KINDS[kind]}"
    article = (
        "Quadratic in the moments of the extremes for the speed, cubic in their values for the distance."
    )
    if rows.empty:
        return Section(
            str(number), title, article, missing=f"No {KINDS[kind]} calibration slide in this folder."
        )
    chi, f = best.method.speed.coefficients[kind], best.method.distance.coefficients[kind]
    here = (
        f"Fitted to {len(rows)} calibration slides, t from the chamber's edge, {LEAST_SPEED_MM_S:g} mm/s and faster: "
        + "; ".join(
            f"v = {_polynomial(chi[e], 't')} at the {WORDS[e]}" for e in range(2) if np.isfinite(chi[e]).all()
        )
        + ". "
        + "; ".join(
            f"d = {_polynomial(f[e], 'V')} at the {WORDS[e]}" for e in range(2) if np.isfinite(f[e]).all()
        )
        + "."
    )
    panels = (
        _speed_panel(rows, published.method, best.method, kind),
        _distance_panel(rows, best.method, kind),
    )
    columns = ["recording", "speed_mm_s", "distance_mm", "trigger_mm"]
    table = rows[[*columns, *(f"{e}_{unit}" for e in ("low", "high") for unit in ("s", "mm", "v"))]].copy()
    for e in ("low", "high"):
        table[f"{e}_since_edge_s"] = table[f"{e}_mm"] / table["speed_mm_s"]
    return Section(str(number), title, article, here, panels, table)


def estimates(results: Mapping[str, Scored], axis: int) -> Section:
    """Figures 21 and 22: estimated against actual speed and distance, of slides that were not fitted."""
    letter, figures = "XY"[axis], ("21", "22")[axis]
    ends = {name: _end(scored.new, axis) for name, scored in results.items()}
    title = f"Estimated against actual speed and distance, {letter}-slides"
    limit = ("5 <= |y| <= 17.5", "10 <= x <= 22.5")[axis]
    article = (
        f"Speed within 8 % in the detectable area, distance within 15 % for {limit} mm, about 40 % at 2.5 mm."
    )
    if all(end.empty for end in ends.values()):
        return Section(figures, title, article, missing=f"No {letter}-slide to test on in this folder.")
    panels = [
        _against(ends, "speed_mm_s", "true_speed_mm_s", "speed, mm/s", SPEED_LIMIT, letter),
        _against(ends, "distance", "distance_mm", "distance, mm", DISTANCE_LIMIT, letter),
        _errors(
            ends,
            "speed_percent_error",
            "true_speed_mm_s",
            "speed, mm/s",
            "speed error, %",
            SPEED_LIMIT,
            letter,
        ),
        _errors(
            ends,
            "offset_percent_error",
            "distance_mm",
            "distance, mm",
            "distance error, %",
            DISTANCE_LIMIT,
            letter,
        ),
    ]
    on = next(iter(results.values())).on
    here = f"On {on}. " + " ".join(f"{name.capitalize()}: {_sentence(end)}" for name, end in ends.items())
    columns = [
        "recording",
        "split",
        "true_speed_mm_s",
        "speed_mm_s",
        "speed_percent_error",
        "distance_mm",
        "offset_mm",
    ]
    columns += ["true_offset_mm", "offset_percent_error", "valid"]
    table = pd.concat([end[columns].assign(method=name) for name, end in ends.items()], ignore_index=True)
    return Section(figures, title, article, here, tuple(panels), table)


def areas(best: Scored, chamber_mm: tuple[float, float], board_mm: tuple[float, float]) -> Section:
    """Figure 23: where the method detects and where it locates, as measured."""
    table = pd.concat([area_table(_end(best.new, axis)).assign(axis="XY"[axis]) for axis in (0, 1)])
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


def published_minimum() -> tuple[float, float]:
    """Time (s) and speed (mm/s) at the vertex of the article's published quadratic."""
    c, b, a = PUBLISHED_CHI
    return -b / (2 * a), c - b * b / (4 * a)


def _end(scored: pd.DataFrame, axis: int) -> pd.DataFrame:
    end = scored[(scored["stroke_fraction"] == 1.0) & (scored["kind"] % 2 == axis)]
    end = end[end["true_speed_mm_s"] <= 4.0 + 1e-9]
    return end.assign(distance=end["offset_mm"].abs())


def _polynomial(coefficients: np.ndarray, of: str) -> str:
    """v0 + v1 t + v2 t^2 as a text."""
    powers = ("", f" {of}", f" {of}^2", f" {of}^3")
    terms = [f"{c:+.4g}{powers[n]}" for n, c in enumerate(coefficients)]
    return " ".join(terms).lstrip("+").replace(" +", " + ").replace(" -", " − ")


def _sentence(end: pd.DataFrame) -> str:
    answered = end[end["valid"]]
    if answered.empty:
        return "no slide is answered."
    return (
        f"{len(answered)} of {len(end)} slides answered, speed {answered['speed_percent_error'].mean():.1f} % "
        "off on average and "
        f"{answered['speed_percent_error'].max():.0f} % at most, distance "
        f"{answered['offset_mm_error'].mean():.2f} mm and "
        f"{answered['offset_mm_error'].max():.2f} mm."
    )


def _speed_panel(rows: pd.DataFrame, published: Method, best: Method, kind: int) -> Panel:
    with panel() as (figure, ax):
        longest = float((rows[["low_mm", "high_mm"]].max(axis=1) / rows["speed_mm_s"]).max())
        for e, name in enumerate(("low", "high")):
            times = rows[f"{name}_mm"] / rows["speed_mm_s"]
            ax.plot(
                times,
                rows["speed_mm_s"],
                "o",
                markersize=3,
                alpha=0.6,
                color=COLOURS[e],
                label=f"t of the {WORDS[e]}",
            )
            low, high = best.times_s[kind, e]
            _curve(ax, best.speed, kind, e, low, high, "-", COLOURS[e])
        if kind == 0:
            t = np.linspace(5, max(longest, 30.0), 200)
            ax.plot(
                t,
                np.polynomial.Polynomial(PUBLISHED_CHI)(t),
                ":",
                color=INK,
                label="the article's, t of the maximum",
            )
        ax.set(xlabel="t since the chamber's edge, s", ylabel="speed, mm/s", title="speed", ylim=(0, 8))
        ax.legend(fontsize=8)
        text = (
            f"Speed against the moments of the extremes in {KINDS[kind]} calibration slides; lines: "
            "quadratics fitted to "
            f"{LEAST_SPEED_MM_S:g} mm/s and more, over the times fitted."
        )
        return Panel(inline(figure, text), text)


def _distance_panel(rows: pd.DataFrame, best: Method, kind: int) -> Panel:
    with panel() as (figure, ax):
        for e, name in enumerate(("low", "high")):
            ax.plot(
                1000 * rows[f"{name}_v"],
                rows["distance_mm"],
                "o",
                markersize=3,
                alpha=0.6,
                color=COLOURS[e],
                label=f"V of the {WORDS[e]}",
            )
            low, high = best.volts[kind, e]
            if np.isfinite([low, high]).all():
                v = np.linspace(low, high, 100)
                ax.plot(
                    1000 * v,
                    np.polynomial.Polynomial(best.distance.coefficients[kind, e])(v),
                    color=COLOURS[e],
                )
        ax.set(xlabel="extreme value, mV", ylabel="distance, mm", title="distance", ylim=(-1, 26))
        ax.legend(fontsize=8)
        text = f"Distance of the line against the extreme values in {KINDS[kind]} calibration slides; lines: cubics."
        return Panel(inline(figure, text), text)


def _curve(
    ax: Axes, polynomials: Polynomials, kind: int, e: int, low: float, high: float, style: str, colour: str
) -> None:
    if np.isfinite([low, high]).all():
        t = np.linspace(low, high, 100)
        ax.plot(t, np.polynomial.Polynomial(polynomials.coefficients[kind, e])(t), style, color=colour)


def _against(
    ends: Mapping[str, pd.DataFrame], said: str, true: str, title: str, limit: float, letter: str
) -> Panel:
    with panel() as (figure, ax):
        longest = max(float(end[true].max()) for end in ends.values() if len(end))
        line = np.array([0, 1.05 * longest])
        ax.plot(line, line, color=EDGE, linewidth=1)
        ax.fill_between(
            line, line * (1 - limit / 100), line * (1 + limit / 100), color=EDGE, alpha=0.2, linewidth=0
        )
        for n, (name, end) in enumerate(ends.items()):
            rows = end[end["valid"]]
            beyond = int((rows[said] > 1.5 * longest).sum())
            label = name + (f" ({beyond} beyond)" if beyond else "")
            ax.plot(
                rows[true], rows[said], "o", markersize=3, alpha=0.7, color=COLOURS[(1, 0)[n]], label=label
            )
        ax.set(
            xlabel=f"actual {title}",
            ylabel=f"estimated {title}",
            title=title.split(",")[0],
            ylim=(0, 1.5 * longest),
        )
        ax.legend(fontsize=8)
        text = (
            f"Estimated against actual {title.split(',')[0]} of {letter}-slides that were not fitted; the "
            f"band is the article's {limit:g} %."
        )
        return Panel(inline(figure, text), text)


def _errors(
    ends: Mapping[str, pd.DataFrame], error: str, label: str, of: str, title: str, limit: float, letter: str
) -> Panel:
    with panel() as (figure, ax):
        drawn = []
        for n, (name, end) in enumerate(ends.items()):
            rows = end[end["valid"] & end[error].notna()]
            drawn.append(rows[error].to_numpy(float))
            ax.plot(
                rows[label], rows[error], "o", markersize=3, alpha=0.7, color=COLOURS[(1, 0)[n]], label=name
            )
        ax.axhline(limit, color=INK, linestyle="--", linewidth=1)
        log_with_zero(ax, np.concatenate([*drawn, [limit]]))
        ax.set(xlabel=of, title=title)
        ax.legend(fontsize=8)
        text = (
            f"{title.split(',')[0].capitalize()} of each {letter}-slide; dashed: the article's {limit:g} %."
        )
        return Panel(inline(figure, text), text)


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

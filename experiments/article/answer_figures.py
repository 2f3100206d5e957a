"""Figures 17 to 25: the interpolation, its answers on slides that were not fitted, and where it works."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.article.axis_slides import EXTREMES, AxisSlides
from softslide.experiments.article.method import LEAST_SPEED_MM_S, Method
from softslide.experiments.article.scoring import Scored, at_end
from softslide.experiments.article.section import Section
from softslide.experiments.article.slide_figures import SINCE_EDGE, delays_mm, nearest
from softslide.experiments.evaluation.figures import paths
from softslide.experiments.evaluation.scoring import AXES
from softslide.experiments.pages.figures import COLOURS, EDGE, INK, Panel, chart, on_skin
from softslide.models.classical.interpolation import DETECTABLE_MM
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor

# The one fit that the article still shows, of X-sliding: v in mm/s of t_max in s, coefficients in rising powers.
PUBLISHED_CHI = (7.4336, -0.4331, 0.008)
SPEED_LIMIT, DISTANCE_LIMIT = 8.0, 15.0  # %, the article's
BIN_MM = 2.5
SHOWN_MM, SHOWN_MM_S = (5.0, 10.0, 15.0), 2.0  # of the trajectories


def published_minimum() -> tuple[float, float]:
    """Time (s) and speed (mm/s) at the vertex of the article's published quadratic."""
    c, b, a = PUBLISHED_CHI
    return -b / (2 * a), c - b * b / (4 * a)


def interpolation(whole: AxisSlides, best: Method, kind: int) -> Section:
    """Figures 17 to 20: the curves of one kind of slide, with the calibration slides that they are fitted to."""
    # In the article: X forward, X backward, Y forward, Y backward.
    number = str((17, 19, 18, 20)[kind])
    rows = whole.table[(whole.table["kind"] == kind) & whole.table["split"].str.startswith(CALIBRATION)]
    title = f"Interpolation of speed and distance, {AXES[kind]}"
    says = "Quadratic in the moments of the extremes for the speed, cubic in their values for the distance."
    if rows.empty:
        return Section(number, title, says, missing=f"No {AXES[kind]} calibration slide in this folder.")
    chi, f = best.speed.coefficients[kind], best.distance.coefficients[kind]
    curves = [("v", "t", chi), ("d", "V", f)]
    here = f"Fitted to {len(rows)} slides, t from the chamber's edge, {LEAST_SPEED_MM_S:g} mm/s and faster: "
    here += "; ".join(
        f"{of} = {_polynomial(each[e], letter)} at the {word}"
        for of, letter, each in curves
        for e, word in enumerate(EXTREMES.values())
        if np.isfinite(each[e]).all()
    )
    columns = [f"{e}_{unit}" for e in EXTREMES for unit in ("s", "mm", "v")]
    table = rows[["recording", "speed_mm_s", "distance_mm", "trigger_mm", *columns]].copy()
    for e in EXTREMES:
        table[f"{e}_since_edge_s"] = table[f"{e}_mm"] / table["speed_mm_s"]
    return Section(number, title, says, here + ".", tuple(_curves(table, best, kind)), table)


def _curves(rows: pd.DataFrame, best: Method, kind: int) -> list[Panel]:
    """Slides as points with the polynomials fitted to them, over the abscissas fitted."""

    def speeds(ax: Axes) -> None:
        _draw_fitted(ax, best.speed.coefficients[kind], best.times_s[kind], 1.0)
        if kind == 0:
            t = np.linspace(5, max(float(times["x"].max()), 30.0), 200)
            curve = np.polynomial.Polynomial(PUBLISHED_CHI)(t)
            ax.plot(t, curve, ":", color=INK, label="the article's, t of the maximum")

    def distances(ax: Axes) -> None:
        _draw_fitted(ax, best.distance.coefficients[kind], best.volts[kind], 1000.0)

    times, values = (
        pd.concat(
            [rows.assign(x=unit * rows[f"{e}_{of}"], of=f"{letter} of the {EXTREMES[e]}") for e in EXTREMES]
        )
        for letter, of, unit in (("t", "since_edge_s", 1.0), ("V", "v", 1000.0))
    )
    texts = (
        f"Speed against the moments of the extremes in {AXES[kind]} calibration slides; lines: quadratics fitted to "
        f"{LEAST_SPEED_MM_S:g} mm/s and more, over the times fitted.",
        f"Distance of the line against the extreme values in {AXES[kind]} calibration slides; lines: cubics.",
    )
    speed, distance = ("speed", SINCE_EDGE, "speed, mm/s"), ("distance", "extreme value, mV", "distance, mm")
    return [
        chart(times, "x", "speed_mm_s", "of", speed, texts[0], draw=speeds, ylim=(0, 8)),
        chart(values, "x", "distance_mm", "of", distance, texts[1], draw=distances, ylim=(-1, 26)),
    ]


def _draw_fitted(ax: Axes, coefficients: np.ndarray, over: np.ndarray, unit: float) -> None:
    """Each extreme's polynomial over the abscissas fitted, of which the axis shows so many times as many."""
    for e in np.flatnonzero(np.isfinite(over).all(axis=1)):
        along = np.linspace(over[e, 0], over[e, 1], 100)
        ax.plot(unit * along, np.polynomial.Polynomial(coefficients[e])(along), color=COLOURS[e])


def _polynomial(coefficients: np.ndarray, of: str) -> str:
    """v0 + v1 t + v2 t^2 as a text."""
    powers = ("", f" {of}", f" {of}^2", f" {of}^3")
    terms = " ".join(f"{c:+.4g}{power}" for c, power in zip(coefficients, powers, strict=False))
    return terms.lstrip("+").replace(" +", " + ").replace(" -", " − ")


def estimates(results: Mapping[str, Scored], axis: int) -> Section:
    """Figures 21 and 22: estimated against actual speed and distance, of slides that were not fitted."""
    letter, number = "XY"[axis], ("21", "22")[axis]
    table = pd.concat([at_end(scored.new, axis).assign(method=name) for name, scored in results.items()])
    title = f"Estimated against actual speed and distance, {letter}-slides"
    limit = ("5 <= |y| <= 17.5", "10 <= x <= 22.5")[axis]
    says = (
        f"Speed within 8 % in the detectable area, distance within 15 % for {limit} mm, about 40 % at 2.5 mm."
    )
    if table.empty:
        return Section(number, title, says, missing=f"No {letter}-slide to test on in this folder.")
    here = f"On {next(iter(results.values())).on}. "
    here += " ".join(
        f"{str(name).capitalize()}: {_sentence(end)}" for name, end in table.groupby("method", sort=False)
    )
    panels = (
        _against(table, letter, "speed", "mm/s", "true_speed_mm_s", "speed_mm_s", SPEED_LIMIT),
        _against(table, letter, "distance", "mm", "distance_mm", "distance", DISTANCE_LIMIT),
    )
    columns = ["recording", "split", "true_speed_mm_s", "speed_mm_s", "speed_percent_error", "distance_mm"]
    columns += ["offset_mm", "true_offset_mm", "offset_percent_error", "valid", "method"]
    return Section(number, title, says, here, panels, table[columns])


def _sentence(end: pd.DataFrame) -> str:
    answered = end[end["valid"]]
    if answered.empty:
        return "no slide is answered."
    speed, distance = answered["speed_percent_error"], answered["offset_mm_error"]
    return (
        f"{len(answered)} of {len(end)} slides answered, speed {speed.mean():.1f} % off on average, {speed.max():.0f} "
        f"% at most, distance {distance.mean():.2f} mm and {distance.max():.2f} mm."
    )


def _against(
    table: pd.DataFrame, letter: str, word: str, unit: str, true: str, estimate: str, limit: float
) -> Panel:
    """Estimates against the truth, a series a method."""
    longest, answered = float(table[true].max()), table[table["valid"]]
    beyond = answered[answered[estimate] > 1.5 * longest].groupby("method").size()
    counted = {name: f"{name} ({count} beyond)" for name, count in beyond.items()}
    shown = answered.assign(method=answered["method"].replace(counted))

    def band(ax: Axes) -> None:
        line = np.array([0, 1.05 * longest])
        ax.plot(line, line, color=EDGE, linewidth=1)
        low, high = line * (1 - limit / 100), line * (1 + limit / 100)
        ax.fill_between(line, low, high, color=EDGE, alpha=0.2, linewidth=0)

    text = f"Estimated against actual {word} of new {letter}-slides; the band is the article's {limit:g} %."
    labels, colours = (word, f"actual {word}, {unit}", f"estimated {word}, {unit}"), (COLOURS[1], COLOURS[0])
    top = (0, 1.5 * longest)
    return chart(shown, true, estimate, "method", labels, text, draw=band, ylim=top, colours=colours)


def areas(best: Scored, sensor: Sensor) -> Section:
    """Figure 23: where the method detects and where it locates, as measured."""
    tables = [area_table(at_end(best.new, axis)).assign(axis="XY"[axis]) for axis in (0, 1)]
    table, title = pd.concat(tables), "Detectable and effective area, as measured"
    if table.empty:
        return Section("23", title, "", missing="No slide along x or y to test on.")
    reach = [
        f"{letter}-slides: detectable at {_listed(rows, 'detectable')}, effective at {_listed(rows, 'effective')} mm."
        for letter, rows in table.groupby("axis")
    ]
    return Section(
        "23",
        title,
        "Detectable: |y| <= 17.5 mm (X) and 0 <= x <= 25 mm (Y), direction right and speed within 8 %. Effective: 5 <= "
        "|y| <= 17.5 mm and 10 <= x <= 22.5 mm, distance within 15 %.",
        f"At its best, on {best.on}; answered slides alone, bins of {BIN_MM:g} mm. {' '.join(reach)}",
        tuple(_area_panel(rows, axis, sensor) for axis, rows in enumerate(tables) if len(rows)),
        table,
    )


def area_table(end: pd.DataFrame) -> pd.DataFrame:
    """By bins of the distance: slides, share answered, share of these with the right direction, largest errors."""
    bins = BIN_MM * (end["distance_mm"] / BIN_MM).round()
    # What is not answered has no error.
    table = (
        end.assign(right=end["direction_deg_error"] < 45)
        .groupby(bins)
        .agg(
            slides=("valid", "size"),
            answered=("valid", "sum"),
            direction_right=("right", "sum"),
            speed_percent_max=("speed_percent_error", "max"),
            distance_percent_max=("offset_percent_error", "max"),
        )
    )
    right = (table["answered"] > 0) & (table["direction_right"] == table["answered"])
    table["detectable"] = right & (table["speed_percent_max"] < SPEED_LIMIT)
    table["effective"] = table["detectable"] & (table["distance_percent_max"] < DISTANCE_LIMIT)
    return table.rename_axis("distance_mm").reset_index()


def _listed(rows: pd.DataFrame, column: str) -> str:
    return ", ".join(f"{d:g}" for d in rows.loc[rows[column], "distance_mm"]) or "no"


def _area_panel(rows: pd.DataFrame, axis: int, sensor: Sensor) -> Panel:
    board, across = sensor.accelerometers[0], 1 - axis
    centre, half = (board.x_mm, board.y_mm)[across], sensor.chamber_mm[across] / 2
    colours = {"effective": COLOURS[2], "detectable": COLOURS[5], "neither": COLOURS[1]}

    def draw(ax: Axes) -> None:
        for row in rows.to_dict("records"):
            name = "effective" if row["effective"] else "detectable" if row["detectable"] else "neither"
            for place in {centre + row["distance_mm"], centre - row["distance_mm"]}:
                low, high = np.clip([place - BIN_MM / 2, place + BIN_MM / 2], -half, half)
                (ax.axhspan, ax.axvspan)[axis](low, high, color=colours[name], alpha=0.45, linewidth=0)
        for name, colour in colours.items():
            ax.plot([], [], "s", color=colour, alpha=0.45, label=name)
        for reach in (-DETECTABLE_MM[axis], DETECTABLE_MM[axis]):
            (ax.axhline, ax.axvline)[axis](centre + reach, color=INK, linestyle="--", linewidth=1)

    text = (
        f"Measured area of {'XY'[axis]}-slides by the distance of the line, on both sides alike; dashed: the article's "
        "detectable area; blank: no slide."
    )
    return on_skin(sensor, text, draw, f"{'XY'[axis]}-slides")


def trajectories(whole: AxisSlides, best: Scored, sensor: Sensor, axis: int) -> Section:
    """Figures 24 and 25: actual and estimated places in the plane."""
    letter, number = "XY"[axis], ("24", "25")[axis]
    title = f"Trajectories, {letter}-slides"
    says = "(v t, y) and (x, v t) within 15 % once the extremes have passed, after 18 to 21.5 mm of the 50."
    panels, tables = [], []
    for kind in (axis, axis + 2):
        rows = best.new[(best.new["kind"] == kind) & best.new["valid"]]
        ends = rows[rows["stroke_fraction"] == 1.0].assign(speed_mm_s=lambda end: end["true_speed_mm_s"])
        if len(ends):
            names = {str(nearest(ends, distance, SHOWN_MM_S)["recording"]) for distance in SHOWN_MM}
            shown = best.new[best.new["recording"].isin(names)].assign(kind=AXES[kind])
            slides = shown["recording"] + shown["true_speed_mm_s"].map(", {:.2g} mm/s".format)
            text = (
                f"Actual and estimated places of the contact in the plane, {AXES[kind]} slides, at each tenth of the "
                "stroke; no estimate before the extremes."
            )
            panels.append(paths(shown.assign(slide=slides), "slide", sensor, text, AXES[kind]))
            tables.append(shown)
    if not panels:
        return Section(number, title, says, missing=f"No {letter}-slide is answered.")
    columns = ["recording", "stroke_fraction", "travelled_mm", "x_mm", "y_mm", "position_mm_error"]
    columns += ["position_percent_error", "valid", "kind"]
    table, first = pd.concat(tables)[columns], delays_mm(whole)
    here = "The first extreme comes " + ", ".join(
        f"{row.first_mm:.1f} mm past the edge in {row.kind} slides (the article: {row.article_mm:g})"
        for row in first[first["kind"].str.startswith(letter)].itertuples()
    )
    return Section(number, title, says, here + "; medians.", tuple(panels), table)

"""Figures 17 to 20: the interpolation, with the slides that it is fitted to."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from experiments.article.axis_slides import KINDS
from experiments.article.method import LEAST_SPEED_MM_S, Method
from experiments.article.scoring import Scored
from experiments.article.section import Section
from experiments.article.slide_figures import Whole
from experiments.pages.figures import COLOURS, INK, Panel, inline, panel
from models.classical.interpolation import Polynomials

# The one fit that the article still shows, of X-sliding: v in mm/s of t_max in s, coefficients in rising powers.
PUBLISHED_CHI = (7.4336, -0.4331, 0.008)
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


def published_minimum() -> tuple[float, float]:
    """Time (s) and speed (mm/s) at the vertex of the article's published quadratic."""
    c, b, a = PUBLISHED_CHI
    return -b / (2 * a), c - b * b / (4 * a)


def _polynomial(coefficients: np.ndarray, of: str) -> str:
    """v0 + v1 t + v2 t^2 as a text."""
    powers = ("", f" {of}", f" {of}^2", f" {of}^3")
    terms = [f"{c:+.4g}{powers[n]}" for n, c in enumerate(coefficients)]
    return " ".join(terms).lstrip("+").replace(" +", " + ").replace(" -", " − ")


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

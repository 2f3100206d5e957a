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
            curve = best.speed.coefficients[kind, e]
            _fitted(ax, e, "t", times, rows["speed_mm_s"], curve, best.times_s[kind, e])
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
            curve = best.distance.coefficients[kind, e]
            _fitted(ax, e, "V", rows[f"{name}_v"], rows["distance_mm"], curve, best.volts[kind, e], 1000)
        ax.set(xlabel="extreme value, mV", ylabel="distance, mm", title="distance", ylim=(-1, 26))
        ax.legend(fontsize=8)
        text = f"Distance of the line against the extreme values in {KINDS[kind]} calibration slides; lines: cubics."
        return Panel(inline(figure, text), text)


def _fitted(
    ax: Axes,
    e: int,
    letter: str,
    x: pd.Series,
    y: pd.Series,
    coefficients: np.ndarray,
    fitted_over: np.ndarray,
    scale: float = 1.0,
) -> None:
    """The slides as points and the polynomial fitted to them, of the extreme e (0 minimum, 1 maximum).

    letter: what x is. fitted_over: (2,), the least and largest x of the fit. scale: of the axis, over x.
    """
    ax.plot(scale * x, y, "o", markersize=3, alpha=0.6, color=COLOURS[e], label=f"{letter} of the {WORDS[e]}")
    low, high = fitted_over
    if np.isfinite([low, high]).all():
        along = np.linspace(low, high, 100)
        ax.plot(scale * along, np.polynomial.Polynomial(coefficients)(along), color=COLOURS[e])

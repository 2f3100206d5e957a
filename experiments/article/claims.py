"""The article's claims: what it says, what the recordings at hand show, whether it holds, and why."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from softslide.experiments.article.answer_figures import published_minimum
from softslide.experiments.article.axis_slides import AxisSlides
from softslide.experiments.article.method import BEST, PUBLISHED
from softslide.experiments.article.scoring import Scored
from softslide.experiments.article.skin_figures import HEIGHT_LIMIT_PERCENT
from softslide.experiments.article.slide_figures import delays_mm, extreme_place, sign_share, speed_effect
from softslide.experiments.evaluation.bounds import Verdict, check, read_bounds
from softslide.experiments.evaluation.scoring import QUANTITIES
from softslide.experiments.pages.page import number

HOLDS, PARTLY, FAILS, UNTESTED = "holds", "in part", "does not hold", "not tested"


class Claim(NamedTuple):
    """source: the article's section or figure. verdict: one of HOLDS, PARTLY, FAILS, UNTESTED."""

    claim: str
    source: str
    claimed: str
    measured: str
    verdict: str
    why: str


def claims_table(
    whole: AxisSlides | None, results: Mapping[str, Scored], skin: pd.DataFrame, pressure: pd.DataFrame
) -> pd.DataFrame:
    """The claims, a row each. results: by variant; skin: the table of figure 11; pressure: of figure 26."""
    found: list[Claim] = []
    if whole is not None and results:
        bounds = _bounds(results[PUBLISHED.name], results[BEST.name])
        found += [_signs(whole), *bounds, *_moments(whole), _delay(whole)]
    return pd.DataFrame([*found, _polynomial(), _height(skin), _pressure(pressure)], columns=Claim._fields)


def _signs(whole: AxisSlides) -> Claim:
    share = sign_share(whole)
    why = "on lines near the accelerometer the output across is near zero, and far ones are weak"
    return Claim(
        "X- and Y-slides, forward and backward, are distinguished by the signs of V_x and V_y",
        "5.2.1, figure 14",
        "in the detectable area",
        f"{share.sum()} of {len(share)} slides",
        HOLDS if share.all() else PARTLY if share.mean() > 0.9 else FAILS,
        "every slide's signs show its kind" if share.all() else why,
    )


def _bounds(published: Scored, best: Scored) -> list[Claim]:
    """The article's bounds, as `evaluate` checks them, of both variants."""
    claims = []
    for bound in read_bounds():
        plain, own = check(bound, published.new), check(bound, published.fitted)
        kind, unit = check(bound, best.new), QUANTITIES[bound.quantity]
        answered = kind.met is not None and kind.max is not None and kind.max < bound.limit
        measured = (
            f"as published {_errors(plain)} on {published.on}, {_errors(own)} on the slides fitted; at its best "
            f"{_errors(kind)}"
        )
        verdict = UNTESTED if plain.met is None else HOLDS if plain.met else PARTLY if answered else FAILS
        claimed = f"< {bound.limit:g} {unit}: {bound.says}"
        claims.append(Claim(bound.name, bound.source, claimed, measured, verdict, _why(plain, kind)))
    return claims


def _errors(verdict: Verdict) -> str:
    if verdict.met is None:
        return "not tested"
    if verdict.max is None:
        return "no answer"
    gaps = f", {verdict.missing} without an answer" if verdict.missing else ""
    return f"{number(verdict.max)} {QUANTITIES[verdict.bound.quantity]} at most ({verdict.recordings} slides{gaps})"


def _why(plain: Verdict, best: Verdict) -> str:
    if plain.met is None:
        return "no such recording"
    if plain.met:
        return "met by every slide"
    if best.max is None:
        return "the polynomials end with the fastest slide that they are fitted to"
    if best.max < plain.bound.limit:
        return "as published it answers slides that its polynomials do not fit; at its best it is silent on these"
    return "moments and values depend on both speed and distance, most of all between the lines fitted"


def _moments(whole: AxisSlides) -> list[Claim]:
    claims = []
    for kind, word in ((0, "X"), (1, "Y")):
        rows = whole.table[whole.table["kind"] == kind]
        if rows["distance_mm"].nunique() < 3:
            continue
        low, high = extreme_place(rows)["low"]
        spread, drift = 100 * (high - low) / ((high + low) / 2), speed_effect(rows)
        claims.append(
            Claim(
                f"the moments of the extremes depend on the speed alone ({word}-slides)",
                "5.2.2, figures 15b and 16b",
                "not on the distance",
                f"the minimum comes {low:.1f} to {high:.1f} mm past the edge, by the line ({spread:.0f} %)",
                HOLDS if spread < 8 else FAILS,
                "the line's distance moves the extreme, which by itself limits the speed",
            )
        )
        if drift is not None:
            claims.append(
                Claim(
                    f"the values of the extremes depend on the distance alone ({word}-slides)",
                    "5.2.2, figures 15a and 16a",
                    "not on the speed",
                    f"{drift:.1f} % between speeds of one line (median range)",
                    HOLDS if drift < 8 else PARTLY,
                    "slides repeat to a few percent; the skin's lag adds little up to 4 mm/s",
                )
            )
    return claims


def _delay(whole: AxisSlides) -> Claim:
    table = delays_mm(whole)
    off = (table["first_mm"] - table["article_mm"]).abs().max()
    return Claim(
        "the first estimate comes after 18, 20.5, 17.5 and 21.5 mm of the 50",
        "5.2.2, before 5.3",
        "about 2/5 of the stroke",
        ", ".join(f"{row.kind} {row.first_mm:.1f} mm" for row in table.itertuples()),
        HOLDS if off <= 2.5 else PARTLY if off <= 5 else FAILS,
        "it goes by where the accelerometer lies, and so differs between sensors",
    )


def _polynomial() -> Claim:
    when, least = published_minimum()
    return Claim(
        "v = 0.008 t^2 - 0.4331 t + 7.4336 covers X-slides",
        "figure 17",
        "0.5 to 4 mm/s",
        f"its minimum is {least:.2f} mm/s, at {when:.1f} s",
        FAILS,
        "a parabola turns; slower slides, whose extremes come later, read as faster ones",
    )


def _height(skin: pd.DataFrame) -> Claim:
    """Against a laser's readings where there are any, else against the solved skin."""
    known = skin.dropna(subset=["formula_error_percent"])
    recorded = known[known["source"] == "recordings"].sort_values("laser_mm")
    rows, of = (recorded, f"{len(recorded)} laser readings") if len(recorded) else (known, "the solved skin")
    error = rows["formula_error_percent"]
    words = ("the skin's height follows from V_x by the formula", "5.1, figure 11")
    if error.empty:
        return Claim(*words, "< 12 %", "-", UNTESTED, "the board is at the centre")
    inside = float((error.abs() < HEIGHT_LIMIT_PERCENT).mean())
    verdict = HOLDS if inside == 1 else PARTLY if inside > 0 else FAILS
    measured = f"{error.iloc[0]:+.0f} % on the lowest to {error.iloc[-1]:+.0f} % on the highest of {of}"
    return Claim(*words, "< 12 %", measured, verdict, "the skin is no parabola, least of all while it is low")


def _pressure(pressure: pd.DataFrame) -> Claim:
    swing = pressure.groupby("height_mm")["vy_v"].agg(np.ptp)
    rises = bool((swing.diff().dropna() > 0).all()) if len(swing) > 1 else None
    return Claim(
        "more pressure gives more output",
        "5.3, figures 6 and 26",
        "the output grows, less above 0.035 MPa",
        ", ".join(f"{1000 * v:.0f} mV at {h:.3g} mm" for h, v in swing.items()) + " (V_y, solved skin)",
        UNTESTED if rises is None else HOLDS if rises else FAILS,
        "a higher dome leans further under the same contact" if rises else "the output falls again",
    )

"""The article's claims: what it says, what the recordings at hand show, whether it holds, and why."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from experiments.article.interpolation_figures import published_minimum
from experiments.article.place_figures import delays_mm
from experiments.article.scoring import Scored
from experiments.article.slide_figures import Whole, extreme_place, sign_share, speed_effect
from experiments.evaluation.bounds import Bound, Verdict
from experiments.evaluation.scoring import QUANTITIES
from experiments.pages.page import number

HOLDS, FAILS, UNTESTED, PARTLY = "holds", "does not hold", "not tested", "in part"
HEIGHT_LIMIT = 12.0


@dataclass(frozen=True)
class Claim:
    """source: the article's section or figure. verdict: one of HOLDS, PARTLY, FAILS, UNTESTED."""

    claim: str
    source: str
    claimed: str
    measured: str
    verdict: str
    why: str


def claims_table(
    whole: Whole | None,
    published: Scored | None,
    best: Scored | None,
    bounds: Sequence[Bound],
    skin: pd.DataFrame,
    pressure: pd.DataFrame,
) -> pd.DataFrame:
    """The claims, a row each. skin: the table of figure 11; pressure: of figure 26."""
    found: list[Claim] = []
    if whole is not None and published is not None and best is not None:
        found += [_signs(whole), *_bounds(published, best, bounds), *_moments(whole), _delay(whole)]
    found += [_polynomial(), _height(skin), _pressure(pressure)]
    return pd.DataFrame([asdict(claim) for claim in found])


def polynomial_paragraph(published: Scored | None, best: Scored | None) -> str:
    """Why the published polynomial cannot cover all speeds, with its errors here."""
    when, least = published_minimum()
    text = (
        "The one polynomial that the article prints, v = 0.008 t^2 - 0.4331 t + 7.4336 for X-slides, has its "
        "minimum of "
        f"{least:.2f} mm/s at t = {when:.1f} s and rises again after it. No time gives a lower speed, so that "
        "it cannot cover "
        "0.5 to 1.5 mm/s, three of the article's own eight speeds, and a slower slide, whose extreme comes "
        "later, is taken "
        "for a faster one. A way divided by a time is a hyperbola, which a parabola follows over a short range alone."
    )
    if published is None or best is None:
        return text
    text += (
        " Quadratics fitted to this folder's calibration slides with t from the device's trigger, answering "
        "everything, "
        f"{_largest(published.new, 'speed_percent_error', 0.0, 4.0)}; of slides of 1.5 mm/s and more "
        f"{_largest(published.new, 'speed_percent_error', 1.5, 4.0, short=True)}. With t from the chamber's "
        "edge, fitted to "
        f"1.5 mm/s and more and silent elsewhere, {_largest(best.new, 'speed_percent_error', 0.0, 4.0)}."
    )
    return text


def height_paragraph(skin: pd.DataFrame) -> str:
    """Why the height formula fails, with its errors on the atlas."""
    solved = skin[(skin["source"] == "atlas") & skin["formula_mm"].notna()]
    text = (
        "The height formula takes the inflated skin for a parabola through the chamber's two edges, so that "
        "one slope gives "
        "the height. A clamped thick skin is no parabola: it leaves the rim level, and a rigid board of 10 "
        "mm flattens it where "
        "the slope is read."
    )
    if solved.empty:
        return (
            text
            + " This sensor's board sits at the chamber's centre, or its slope is none: the formula gives nothing here."
        )
    low, high = solved.iloc[0], solved.iloc[-1]
    return text + (
        f" Against the solved skin the formula is {low['formula_error_percent']:+.0f} % off at "
        f"{low['height_mm']:.1f} mm and "
        f"{high['formula_error_percent']:+.0f} % at {high['height_mm']:.1f} mm: it meets the article's 12 % "
        "on high domes alone."
    )


def _largest(scored: pd.DataFrame, column: str, low: float, high: float, short: bool = False) -> str:
    end = scored[
        (scored["stroke_fraction"] == 1.0) & scored["true_speed_mm_s"].between(low - 1e-9, high + 1e-9)
    ]
    answered = end[end["valid"]]
    if answered.empty:
        return "none is answered"
    told = (
        f"{answered[column].max():.0f} % at most"
        if answered[column].max() >= 10
        else f"{answered[column].max():.1f} % at most"
    )
    return told if short else f"are {told} off in speed ({len(answered)} of {len(end)} new slides answered)"


def _signs(whole: Whole) -> Claim:
    share = sign_share(whole)
    return Claim(
        "X- and Y-slides, forward and backward, are told apart by the signs of V_x and V_y",
        "5.2.1, figure 14",
        "in the detectable area",
        f"{share.sum()} of {len(share)} slides",
        HOLDS if share.all() else PARTLY if share.mean() > 0.9 else FAILS,
        "every slide's signs tell its kind"
        if share.all()
        else "on lines near the accelerometer the output across is near zero, and far ones are weak",
    )


def _bounds(published: Scored, best: Scored, bounds: Sequence[Bound]) -> list[Claim]:
    """The article's bounds, as `evaluate` checks them, of both variants."""
    claims = []
    for bound, plain, own, kind in zip(
        bounds,
        published.verdicts(bounds, "new"),
        published.verdicts(bounds, "fitted"),
        best.verdicts(bounds, "new"),
        strict=True,
    ):
        unit = QUANTITIES[bound.quantity]
        answered = None if kind.met is None else kind.max is not None and kind.max < bound.limit
        verdict = UNTESTED if plain.met is None else HOLDS if plain.met else PARTLY if answered else FAILS
        measured = (
            f"as published {_said(plain, unit)} on {published.on}, {_said(own, unit)} on the slides fitted; "
            f"at its best {_said(kind, unit)}"
        )
        claims.append(
            Claim(
                bound.name,
                bound.source,
                f"< {bound.limit:g} {unit}: {bound.says}",
                measured,
                verdict,
                _why(plain, kind),
            )
        )
    return claims


def _said(verdict: Verdict, unit: str) -> str:
    if verdict.met is None:
        return "not tested"
    if verdict.max is None:
        return "no answer"
    gaps = f", {verdict.missing} without an answer" if verdict.missing else ""
    return f"{number(verdict.max)} {unit} at most ({verdict.recordings} slides{gaps})"


def _why(plain: Verdict, best: Verdict) -> str:
    if plain.met is None:
        return "no such recording"
    if plain.met:
        return "met by every slide"
    if best.max is None:
        return "the polynomials end with the fastest slide that they are fitted to"
    if best.max < plain.bound.limit:
        return "as published it answers slides that its polynomials do not fit; at its best it is silent on these"
    return (
        "lines between those fitted are further off than the fitted ones, and moments and values depend on "
        "both speed and distance"
    )


def _moments(whole: Whole) -> list[Claim]:
    claims = []
    for kind, word in ((0, "X"), (1, "Y")):
        rows = whole.table[whole.table["kind"] == kind]
        if rows["distance_mm"].nunique() < 3:
            continue
        low, high = extreme_place(rows)["low"]
        spread = 100 * (high - low) / ((high + low) / 2)
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
        if (drift := speed_effect(rows)) is not None:
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


def _delay(whole: Whole) -> Claim:
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
    error = skin.loc[skin["source"] == "atlas", "formula_error_percent"].dropna()
    if error.empty:
        return Claim(
            "the skin's height follows from V_x",
            "5.1, figure 11",
            "< 12 %",
            "-",
            UNTESTED,
            "the board is at the centre",
        )
    inside = float((error.abs() < HEIGHT_LIMIT).mean())
    return Claim(
        "the skin's height follows from V_x by the formula",
        "5.1, figure 11",
        "< 12 %",
        f"{error.iloc[0]:+.0f} to {error.iloc[-1]:+.0f} % on the solved skin",
        HOLDS if inside == 1 else PARTLY if inside > 0 else FAILS,
        "the skin is no parabola, least of all while it is low; no recording holds a laser's reading",
    )


def _pressure(pressure: pd.DataFrame) -> Claim:
    span = pressure.groupby("height_mm")["vy_v"].agg(np.ptp)
    rises = bool((span.diff().dropna() > 0).all()) if len(span) > 1 else None
    return Claim(
        "more pressure gives more output",
        "5.3, figures 6 and 26",
        "the output grows, less above 0.035 MPa",
        ", ".join(f"{1000 * v:.0f} mV at {h:.3g} mm" for h, v in span.items()) + " (V_y, solved skin)",
        UNTESTED if rises is None else HOLDS if rises else FAILS,
        "a higher dome leans further under the same contact"
        if rises
        else "on the solved skin the output falls again",
    )

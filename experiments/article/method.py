"""The article's method (5.2.2), as published and at its best.

    v = chi(t),    d = f(V),

t and V the moment and the value of an extreme of the output along the motion. As published: chi quadratic, t counted
from the moment at which the device notices the slide, an answer to everything. At its best: t counted from the
chamber's edge, for which the way from the edge to the trigger is fitted as a function of the distance; only slides in
the fitted range of t and V are answered. Fitting relative errors of the speed instead changes neither mean nor largest
error by more than a tenth (experiments/LOG.md).
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from softslide.experiments.article.axis_slides import AxisSlides, extremes_of
from softslide.experiments.evaluation.readout import COLUMNS
from softslide.features.vector.feature_vector import feature_names
from softslide.models.classical.interpolation import (
    DETECTABLE_MM,
    DIRECTIONS_DEG,
    Polynomials,
    degree,
    evaluate_polynomials,
    fit_polynomials,
    side,
    slide_direction,
)

# Outer edges of the article's effective area, by direction.
EFFECTIVE_MM = np.array([17.5, 22.5, 17.5, 22.5])
# The lowest speed that a quadratic in t is fitted to here. The published one has its minimum at 1.57 mm/s.
LEAST_SPEED_MM_S = 1.5
# Of the least and the largest abscissa fitted, by which an answered slide may leave their range.
MARGIN = 0.02
# Of v = chi(t + way / v); each shrinks the error by the way to the trigger over that to the extreme.
ROUNDS = 30
SPEEDS_MM_S = (0.1, 50.0)  # that those rounds are held to
_ELAPSED = feature_names(1).index("elapsed_s")


@dataclass(frozen=True)
class Variant:
    """How the method is used. form: of chi, "quadratic" or "reciprocal", v = a / t + b. edge: t counts from the
    chamber's edge. least_speed_mm_s: of the slides fitted; bounded: these are in the effective area, and slides out of
    the fitted range get no answer."""

    name: str
    form: str = "quadratic"
    edge: bool = False
    least_speed_mm_s: float = 0.0
    bounded: bool = False


PUBLISHED = Variant("as published")
BEST = Variant("at its best", edge=True, least_speed_mm_s=LEAST_SPEED_MM_S, bounded=True)
VARIANTS = (
    PUBLISHED,
    Variant("t from the edge", edge=True),
    BEST,
    Variant("v = a / t + b, t from the edge", "reciprocal", edge=True, bounded=True),
)


@dataclass(frozen=True)
class Method:
    """A variant with its polynomials. trigger: (4, 3) coefficients, in rising powers of the distance (mm), of the way
    (mm) from the edge to the trigger. way_mm: (4, 2) from the edge to each extreme. times_s, volts: (4, 2, 2) lowest
    and highest abscissa fitted. start_mm: (4,) where a slide triggers, from the accelerometer's foot."""

    variant: Variant
    speed: Polynomials
    distance: Polynomials
    trigger: np.ndarray
    way_mm: np.ndarray
    times_s: np.ndarray
    volts: np.ndarray
    start_mm: np.ndarray

    def predict(self, slides: AxisSlides) -> pd.DataFrame:
        """Rows of `predictions.csv` for the windows; NaN and not valid where the method gives no answer."""
        features, variant = slides.features, self.variant
        values, moments, passed = extremes_of(features)
        distance = np.clip(evaluate_polynomials(self.distance, values, passed), 0.0, None)
        behind = _powers(distance) * self.trigger
        way = behind.sum(axis=-1) if variant.edge else np.zeros_like(distance)
        speed, times = self._speed(moments, passed, way)
        answered = slide_direction(features) & np.isfinite(speed) & np.isfinite(distance) & (speed > 0)
        if variant.bounded:
            answered &= np.where(passed, _within(times, self.times_s), True).all(axis=-1)
            answered &= np.where(passed, _within(values, self.volts), True).all(axis=-1)
        elapsed = features[:, [_ELAPSED]]
        edge = slides.table["edge_mm"].to_numpy()[:, None]
        along = edge + way + speed * elapsed if variant.edge else self.start_mm + speed * elapsed
        return self._rows(slides, answered, speed, distance * side(features), along)

    def _speed(
        self, moments: np.ndarray, passed: np.ndarray, way: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Speed (n, 4) mm/s and times (n, 4, 2) s since the edge, or since the trigger where `way` (n, 4) mm is 0."""
        # The first guess: the way from trigger to extreme over the time between them.
        each = np.where(passed, (self.way_mm - way[..., None]) / np.where(passed, moments, 1.0), 0.0)
        speed = each.sum(axis=-1) / np.maximum(passed.sum(axis=-1), 1)
        times = moments
        for _ in range(ROUNDS if self.variant.edge else 1):
            times = (
                moments + (way / np.clip(speed, *SPEEDS_MM_S))[..., None] if self.variant.edge else moments
            )
            speed = evaluate_polynomials(self.speed, _argument(times, passed, self.variant.form), passed)
        return speed, times

    def _rows(
        self,
        slides: AxisSlides,
        answered: np.ndarray,
        speed: np.ndarray,
        offset: np.ndarray,
        along: np.ndarray,
    ) -> pd.DataFrame:
        some = answered.any(axis=1)
        kind = answered.argmax(axis=1)

        def chosen(values: np.ndarray) -> np.ndarray:
            return np.where(some, np.take_along_axis(values, kind[:, None], axis=1)[:, 0], np.nan)

        angle = np.deg2rad(DIRECTIONS_DEG[kind])
        offset_mm, along_mm = chosen(offset), chosen(along)
        x, y = slides.folder.sensor.reference_mm
        table = pd.DataFrame(np.nan, index=range(len(slides)), columns=list(COLUMNS)).assign(
            recording=slides.table["recording"],
            stroke_fraction=slides.table["fraction"],
            direction_deg=np.where(some, DIRECTIONS_DEG[kind], np.nan),
            speed_mm_s=chosen(speed),
            offset_mm=offset_mm,
            x_mm=x + np.cos(angle) * along_mm - np.sin(angle) * offset_mm,
            y_mm=y + np.sin(angle) * along_mm + np.cos(angle) * offset_mm,
        )
        return table.assign(valid=pd.Series(some))


def fit_method(slides: AxisSlides, variant: Variant) -> Method:
    """Fits a variant to whole slides in the article's detectable area.

    slides: windows of calibration slides at the end of the stroke.
    """
    table, kinds = slides.table, slides.table["kind"].to_numpy()
    ours = kinds[:, None] == np.arange(4)
    near = table["distance_mm"].to_numpy()[:, None] <= (EFFECTIVE_MM if variant.bounded else DETECTABLE_MM)
    values, moments, passed = extremes_of(slides.features)
    speed, distance = table["speed_mm_s"].to_numpy(), table["distance_mm"].to_numpy()
    usable = passed & (ours & near)[..., None]
    late = (table["trigger_mm"] / table["speed_mm_s"]).to_numpy()
    known = np.isfinite(late)[:, None, None]
    times = moments + np.nan_to_num(late)[:, None, None] if variant.edge else moments
    timed = usable & (known if variant.edge else True)
    timed &= (speed >= variant.least_speed_mm_s - 1e-9)[:, None, None]
    weight = 1.0 / speed if variant.form == "reciprocal" else np.ones(len(speed))
    argument = _argument(times, passed, variant.form)
    chi = fit_polynomials(argument, timed, speed, degree("speed", variant.form), weight)
    f = fit_polynomials(values, usable, distance, degree("distance", ""), np.ones(len(speed)))
    trigger, way, start = np.full((4, 3), np.nan), np.full((4, 2), np.nan), np.full(4, np.nan)
    travelled = speed[:, None, None] * moments + table["trigger_mm"].to_numpy()[:, None, None]
    for k in range(4):
        rows = (ours & near)[:, k] & np.isfinite(late)
        if rows.sum() > 3:
            trigger[k] = np.linalg.lstsq(_powers(distance[rows]), table["trigger_mm"][rows])[0]
            start[k] = np.median(table["trigger_mm"][rows] + table["edge_mm"][rows])
        for e in range(2):
            if (both := usable[:, k, e] & known[:, 0, 0]).any():
                way[k, e] = np.median(travelled[both, k, e])
    return Method(variant, chi, f, trigger, way, _ranges(times, timed), _ranges(values, usable), start)


def _argument(times: np.ndarray, passed: np.ndarray, form: str) -> np.ndarray:
    """What chi is a polynomial in: t, or 1 / t."""
    return 1.0 / np.where(passed & (times > 0), times, 1.0) if form == "reciprocal" else times


def _powers(distance: np.ndarray) -> np.ndarray:
    """(..., 3): 1, d, d^2."""
    return np.asarray(distance)[..., None] ** np.arange(3)


def _ranges(values: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """(4, 2, 2): lowest and highest value (n, 4, 2) of those usable; empty where none is."""
    low = np.where(usable, values, np.inf).min(axis=0, initial=np.inf)
    high = np.where(usable, values, -np.inf).max(axis=0, initial=-np.inf)
    return np.stack([low, high], axis=-1)


def _within(values: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Whether values (n, 4, 2) lie in their ranges, wider by MARGIN."""
    room = MARGIN * np.abs(ranges)
    with np.errstate(invalid="ignore"):
        return (values >= ranges[..., 0] - room[..., 0]) & (values <= ranges[..., 1] + room[..., 1])

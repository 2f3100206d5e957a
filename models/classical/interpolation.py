"""The article's interpolation (5.2.2), in numpy and in nodes of a graph.

On an axis slide the moments t_min and t_max of the extremes of one output (V_x on X-slides, V_y on Y-slides) depend
on the speed alone and the extreme values on the distance alone:

    v = chi_1(t_min) = chi_2(t_max),    d = f_1(V_min) = f_2(V_max),

chi quadratic, f cubic, one set for each of X forward, Y forward, X backward, Y backward. The direction follows from
the contact zones (2.3). What it does not cover, diagonals among it, is NaN.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from onnx import TensorProto

from softslide.features.angles import wrapped_deg
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.features.vector.feature_vector import feature_matrix, feature_names
from softslide.models.classical.fit import feature_model
from softslide.models.graph.builder import GraphBuilder
from softslide.pipeline.ranges import check_one_of
from softslide.pipeline.recordings.windows import LabelledWindows

# Directions in this order everywhere: X forward, Y forward, X backward, Y backward, deg.
DIRECTIONS_DEG = np.array([0.0, 90.0, 180.0, 270.0])
OUTPUTS = ("direction_cos", "direction_sin", "log_speed", "offset_mm", "along_mm")
# "quadratic" is the published form; "reciprocal", v = a / t + b, is the kinder one: a distance over a time.
SPEED_FORMS = ("quadratic", "reciprocal")
# The article's detectable area: this far on either side of the accelerometer, mm. Farther slides are weak, trigger
# late and would bend the polynomials of all others: they are not fitted, nor answered with a margin for error.
DETECTABLE_MM = np.array([17.5, 25.0, 17.5, 25.0])
_MARGIN_MM = 1.5
# An extreme in the last twentieth of the window may still be rising.
PASSED = 0.95

# A slide this close to an axis counts as along it, deg.
_AXIS_DEG = 1.0
# Share of the stroke up to which a slide surely moves: a slide that is over stands still while its label moves on.
_UNDER_WAY = 0.75
_LEAST_RESIDUAL = 1e-12  # squared, of a polynomial that passes through all its points
_TINY = 1e-300

_COLUMN = {name: k for k, name in enumerate(feature_names(1))}


def _columns(*names: str) -> np.ndarray:
    return np.array([_COLUMN[name] for name in names])


# (4 directions, 2 extremes): the output along the motion, and its minimum and maximum.
_ALONG = ("vx", "vy", "vx", "vy")
_ACROSS = ("vy", "vx", "vy", "vx")
_MOMENTS_S, _MOMENTS, _VALUES, _ACROSS_VALUES = (
    np.stack([_columns(*(f"a0_{output}_{e}_{unit}" for e in ("min", "max"))) for output in outputs])
    for outputs, unit in ((_ALONG, "s"), (_ALONG, "fraction"), (_ALONG, "v"), (_ACROSS, "v"))
)
_FIRST, _LAST, _ACROSS_FIRST, _ACROSS_LAST = (
    _columns(*(f"a0_{output}_sign_{when}" for output in outputs))
    for outputs, when in ((_ALONG, "first"), (_ALONG, "last"), (_ACROSS, "first"), (_ACROSS, "last"))
)
_ELAPSED = _COLUMN["elapsed_s"]
_CENTRE_S = _COLUMN["energy_centre_s"]
# Forward, the output along the motion goes from - to + (zones 1 -> 2, 3 -> 4 on X-slides, 1 -> 3, 2 -> 4 on
# Y-slides); backward the other way.
_SENSE = np.array([-1.0, -1.0, 1.0, 1.0])
# On which side of the motion a contact lies whose output across is negative: +1 to the left.
_SIDE = np.array([-1.0, 1.0, 1.0, -1.0])


def slide_direction(features: np.ndarray) -> np.ndarray:
    """Which of the four directions (n, 4) a slide takes, at most one true, from features (n, F).

    The output along the motion changes sign and the one across keeps its own (0, within the dead band, passes
    for either): the article's table of zones.
    """
    first, last = features[:, _FIRST], features[:, _LAST]
    across_first, across_last = features[:, _ACROSS_FIRST], features[:, _ACROSS_LAST]
    return (first == _SENSE) & (last == -_SENSE) & (across_first * across_last >= 0)


def abscissas(features: np.ndarray, quantity: str, form: str = "") -> tuple[np.ndarray, np.ndarray]:
    """What the polynomials are in, (n, 4, 2), and which of it has come to pass, (n, 4, 2), of features (n, F).

    quantity "speed": t (s from the trigger) in the quadratic form, 1 / t (1/s) in the reciprocal one;
    "distance": the extreme values (V).
    """
    moment = features[:, _MOMENTS]
    bins_edge = 1.0 / 64
    passed = (moment > bins_edge) & (moment < PASSED)
    if quantity == "distance":
        return features[:, _VALUES], passed
    time = features[:, _MOMENTS_S]
    return (1.0 / np.where(passed, time, 1.0) if form == "reciprocal" else time), passed


def degree(quantity: str, form: str) -> int:
    """Cubic in the extreme value; quadratic in t, or linear in 1 / t."""
    return 3 if quantity == "distance" else {"quadratic": 2, "reciprocal": 1}[form]


@dataclass(frozen=True)
class Polynomials:
    """One quantity's coefficients (4, 2, P) in rising powers, and the precision (4, 2) of each polynomial."""

    coefficients: np.ndarray
    precision: np.ndarray


def fit_polynomials(
    abscissa: np.ndarray, usable: np.ndarray, target: np.ndarray, degree: int, weight: np.ndarray
) -> Polynomials:
    """Polynomials by weighted least squares; coefficients are NaN where too little is known.

    abscissa, usable: (n, 4, 2); target, weight: (n,). The precision is one over the mean squared residual.
    """
    coefficients = np.full((4, 2, degree + 1), np.nan)
    precision = np.ones((4, 2))
    for k in range(4):
        for e in range(2):
            rows = usable[:, k, e]
            powers = abscissa[rows, k, e, None] ** np.arange(degree + 1)
            if rows.sum() > degree:
                scale = weight[rows]
                coefficients[k, e] = np.linalg.lstsq(powers * scale[:, None], target[rows] * scale)[0]
                residual = (powers @ coefficients[k, e] - target[rows]) * scale
                precision[k, e] = 1.0 / max(float(np.square(residual).mean()), _LEAST_RESIDUAL)
    return Polynomials(coefficients, precision)


def evaluate_polynomials(polynomials: Polynomials, abscissa: np.ndarray, passed: np.ndarray) -> np.ndarray:
    """What the extremes that have passed say (n, 4), by their precision; NaN where none has. Horner's rule.

    The article writes chi_1 = chi_2 and f_1 = f_2 and does not say which holds when they differ.
    """
    value = np.broadcast_to(polynomials.coefficients[..., -1], abscissa.shape)
    for power in range(polynomials.coefficients.shape[-1] - 2, -1, -1):
        value = value * abscissa + polynomials.coefficients[..., power]
    trust = np.where(passed, polynomials.precision, 0.0)
    total = np.where(passed, value * polynomials.precision, 0.0).sum(axis=-1)
    return np.where(passed.any(axis=-1), total / np.maximum(trust.sum(axis=-1), _TINY), np.nan)


def side(features: np.ndarray) -> np.ndarray:
    """Side (n, 4) of the accelerometer that the line passes on, +1 to the left of the motion, -1 to its right.

    It is the zone's: the sign that the output across keeps, of its larger extreme.
    """
    lean = features[:, _ACROSS_VALUES].sum(axis=-1)
    return np.where(lean < 0, _SIDE, -_SIDE)


@dataclass(frozen=True)
class InterpolationConfig:
    """form: of the speed's polynomial, "reciprocal" (v = a / t + b) or "quadratic", the published one."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    form: str = "reciprocal"

    def __post_init__(self) -> None:
        check_one_of(SPEED_FORMS, form=self.form)


@dataclass(frozen=True)
class Interpolation:
    """Fitted polynomials. speed: in mm/s, of the given form; distance: in mm, cubic.

    start_mm: (4,) where along its line a slide triggers: the article's position (v t, y), seen from the reference.
    """

    form: str
    speed: Polynomials
    distance: Polynomials
    start_mm: np.ndarray
    outputs: ClassVar[tuple[str, ...]] = OUTPUTS

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, 5) in OUTPUTS order of features (n, F); NaN where the method is not defined."""
        features = np.asarray(features, np.float64)
        direction = slide_direction(features)
        angle = np.deg2rad(DIRECTIONS_DEG)
        speed = evaluate_polynomials(self.speed, *abscissas(features, "speed", self.form))
        distance = evaluate_polynomials(self.distance, *abscissas(features, "distance"))
        distance = np.where(distance <= DETECTABLE_MM + _MARGIN_MM, distance, np.nan)
        along = speed * features[:, [_ELAPSED]] + self.start_mm
        each = np.stack(
            np.broadcast_arrays(
                np.cos(angle),
                np.sin(angle),
                np.log(np.where(speed > 0, speed, np.nan)),
                np.maximum(distance, 0.0) * side(features),
                along,
            ),
            axis=-1,
        )
        row = np.where(direction[..., None], each, 0.0).sum(axis=1)
        defined = direction.any(axis=1) & np.isfinite(row).all(axis=1)
        return np.where(defined[:, None], row, np.nan)

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """The same arithmetic in nodes: rows (B, 5) in float64 of features (B, F)."""
        given = g.cast(features, TensorProto.DOUBLE)
        moment = g.columns(given, _MOMENTS)
        passed = g.op(
            "And",
            g.op("Greater", moment, g.constant(1.0 / 64)),
            g.op("Less", moment, g.constant(PASSED)),
        )
        time = g.columns(given, _MOMENTS_S)
        if self.form == "reciprocal":
            time = g.op("Reciprocal", g.op("Where", passed, time, g.constant(1.0)))
        speed = _polynomial_nodes(g, self.speed, time, passed)
        distance = _polynomial_nodes(g, self.distance, g.columns(given, _VALUES), passed)
        near = g.op("LessOrEqual", distance, g.constant(DETECTABLE_MM + _MARGIN_MM))
        distance = g.op("Where", near, distance, g.constant(np.nan))
        elapsed = g.columns(given, np.array([_ELAPSED]))
        along = g.op("Add", g.op("Mul", speed, elapsed), g.constant(self.start_mm))
        lean = g.total(g.columns(given, _ACROSS_VALUES), -1)
        signed = g.op("Where", g.op("Less", lean, g.constant(0.0)), g.constant(_SIDE), g.constant(-_SIDE))
        offset = g.op("Mul", g.op("Max", distance, g.constant(0.0)), signed)
        # Where() in the place of Log's own NaN: runtimes need not agree on the logarithm of a negative speed.
        positive = g.op("Greater", speed, g.constant(0.0))
        log_speed = g.op("Log", g.op("Where", positive, speed, g.constant(np.nan)))
        direction = self._direction_nodes(g, given)
        zero = g.op("Mul", elapsed, g.constant(np.zeros(4)))
        angle = np.deg2rad(DIRECTIONS_DEG)
        cos, sin = (g.op("Add", zero, g.constant(part)) for part in (np.cos(angle), np.sin(angle)))
        row = [
            g.total(g.op("Where", direction, each, g.constant(0.0)), 1, keep=True)
            for each in (cos, sin, log_speed, offset, along)
        ]
        found = g.total(g.cast(direction, TensorProto.DOUBLE), 1, keep=True)
        estimate = g.op("Concat", *row, axis=1)
        # Either all of a row is defined or none: a NaN anywhere, or no direction (0 / 0), spreads over it.
        unknown = g.op("Mul", g.total(estimate, 1, keep=True), g.constant(0.0))
        defined = g.op("Add", g.op("Div", found, found), unknown)
        return g.op("Mul", estimate, defined)

    @staticmethod
    def _direction_nodes(g: GraphBuilder, features: str) -> str:
        """`slide_direction` in nodes: (B, 4) bool."""
        across = g.op("Mul", g.columns(features, _ACROSS_FIRST), g.columns(features, _ACROSS_LAST))
        changed = g.op(
            "And",
            g.op("Equal", g.columns(features, _FIRST), g.constant(_SENSE)),
            g.op("Equal", g.columns(features, _LAST), g.constant(-_SENSE)),
        )
        return g.op("And", changed, g.op("GreaterOrEqual", across, g.constant(0.0)))


def _polynomial_nodes(g: GraphBuilder, polynomials: Polynomials, abscissa: str, passed: str) -> str:
    """`evaluate_polynomials` in nodes: (B, 4)."""
    coefficients, zero = polynomials.coefficients, g.constant(0.0)
    value = g.op("Add", g.op("Mul", abscissa, zero), g.constant(coefficients[..., -1]))
    for power in range(coefficients.shape[-1] - 2, -1, -1):
        value = g.op("Add", g.op("Mul", value, abscissa), g.constant(coefficients[..., power]))
    precision = g.constant(polynomials.precision)
    total = g.total(g.op("Where", passed, g.op("Mul", value, precision), zero), -1)
    return g.op("Div", total, g.total(g.op("Where", passed, precision, zero), -1))


def fit_interpolation(
    windows: LabelledWindows, config: InterpolationConfig = InterpolationConfig()
) -> Interpolation:
    """Fits to the whole axis slides in the detectable area, one set of polynomials a direction.

    The reciprocal form minimizes relative errors of the speed; the published one is a plain polynomial fit.

    Raises:
        InputError: no whole slides along an axis, or more than one accelerometer.
    """
    if (boards := windows.volts.shape[1] // 3) > 1:
        raise InputError(f"the interpolation reads one accelerometer, the recordings have {boards}; use cnn")
    form = config.form
    turned = np.abs(wrapped_deg(windows.direction_deg[:, None] - DIRECTIONS_DEG))
    axis = (turned < _AXIS_DEG) & (np.abs(windows.offset_mm)[:, None] <= DETECTABLE_MM)
    whole = windows.stroke_fraction >= windows.stroke_fraction.max()
    rows = axis.any(axis=1) & whole
    if not rows.any():
        raise InputError("the interpolation needs slides along x or y, over the whole stroke; record some")
    features = feature_matrix(windows.volts, windows.elapsed_s).astype(np.float32).astype(np.float64)
    speed = windows.speed_mm_s
    polynomials = {}
    for quantity, target, weight in (
        ("speed", speed, 1.0 / speed if form == "reciprocal" else np.ones(len(speed))),
        ("distance", np.abs(windows.offset_mm), np.ones(len(speed))),
    ):
        abscissa, passed = abscissas(features[rows], quantity, form)
        usable = passed & axis[rows][:, :, None]
        polynomials[quantity] = fit_polynomials(
            abscissa, usable, target[rows], degree(quantity, form), weight[rows]
        )
    start_mm = np.array([_start_mm(windows[axis[:, k]], features[axis[:, k]]) for k in range(4)])
    return Interpolation(form, polynomials["speed"], polynomials["distance"], start_mm)


def _start_mm(windows: LabelledWindows, features: np.ndarray) -> float:
    """Where along its line a slide triggers, mm from the foot of the perpendicular; NaN if no slide says."""
    start = windows.along_mm - windows.speed_mm_s * windows.elapsed_s
    # A slide that is over stands still while its label moves on.
    under_way = (windows.stroke_fraction < _UNDER_WAY) & np.isfinite(start)
    if under_way.any():
        return float(np.median(start[under_way]))
    # Without a record of the motion: the energy is centred near the foot, where the contact is nearest.
    return float(np.median(-windows.speed_mm_s * features[:, _CENTRE_S])) if len(windows) else np.nan


MODEL = feature_model(InterpolationConfig, fit_interpolation)

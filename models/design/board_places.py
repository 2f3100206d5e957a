"""Where to put the accelerometers: the places whose Cramer-Rao bound over the skin is least.

For lines drawn all over the chamber, each place's readings give Fisher information (line_information.py). Boards are
taken not to disturb each other, so that their information adds; the bound of a set is the inverse of the sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from softslide.features.errors import InputError
from softslide.models.design.line_information import (
    ERRORS,
    STEPS,
    Line,
    criterion,
    draw_lines,
    exchanged,
    reading_variance,
    slopes,
    with_gain_prior,
    without_static,
)
from softslide.models.response_map.from_atlas import DESIGN_NOISE_V, DESIGN_ZERO_V
from softslide.models.response_map.map import PARTS, ResponseMap, half_of, spline_coefficients, spline_grid
from softslide.pipeline.atlas.bare_skin import TiltField
from softslide.pipeline.sensor import Sensor

BOARD_LINES = 300  # that the bound is averaged over
GAP_MM = 0.5  # of skin between two boards
BOARD_SWEEPS = 5  # of exchanges; on the article's skin the third changes nothing
CENTRE_MM = (0.0, 0.0)  # that offsets are measured from: no board stands anywhere yet


@dataclass(frozen=True)
class Arrangement:
    """places_mm: (boards, 2). deviations: (3, L), bounds of direction (rad), log speed and offset (mm) of each line."""

    places_mm: np.ndarray
    deviations: np.ndarray


def lines_over(sensor: Sensor) -> list[Line]:
    """BOARD_LINES lines over the sensor's chamber, seen from its centre."""
    return list(draw_lines(sensor.chamber_mm, CENTRE_MM, BOARD_LINES, np.random.default_rng(0)))


def information(field: TiltField, sensor: Sensor, lines: Sequence[Line]) -> np.ndarray:
    """(P, L, 5, 5): of a board at each place on each line, passed as a whole at LINE_SPEED_MM_S."""
    response, variance = response_of(field, sensor), reading_variance(DESIGN_NOISE_V)
    found = np.empty((len(field.places_mm), len(lines), len(STEPS), len(STEPS)))
    for n, line in enumerate(lines):
        jacobian = slopes(response, line)
        left = without_static(jacobian, DESIGN_ZERO_V, variance)
        one, other = (each.reshape(len(each), -1, 2, len(STEPS)) for each in (left, jacobian))
        found[:, n] = np.einsum("npcj,npck->pjk", one, other, optimize=True) / variance
    return found


def best_places(
    places_mm: np.ndarray, information: np.ndarray, boards: int, board_mm: tuple[float, float]
) -> Arrangement:
    """The set of so many boards that do not overlap with the least criterion: chosen one by one, then exchanged.

    information: (P, L, 5, 5).

    Raises:
        InputError: so many boards do not fit.
    """

    def best(taken: list[int]) -> tuple[int, float]:
        apart = np.abs(places_mm[:, None] - places_mm[taken]) >= np.array(board_mm) + GAP_MM
        free = apart.any(axis=2).all(axis=1)
        if not free.any():
            raise InputError(f"{boards}: only {len(taken)} such boards fit the chamber", "boards")
        values = np.full(len(places_mm), np.inf)
        values[free] = criterion(_variances(information[taken].sum(axis=0) + information[free]))
        return int(values.argmin()), float(values.min())

    chosen = exchanged(best, range(boards), BOARD_SWEEPS)
    return arrangement(places_mm[chosen], information[chosen].sum(axis=0))


def arrangement(places_mm: np.ndarray, information: np.ndarray) -> Arrangement:
    """The bound of boards at these places, of their information (L, 5, 5)."""
    return Arrangement(places_mm, np.sqrt(_variances(information)).T)


def nearest_places(places_mm: np.ndarray, boards_mm: Sequence[tuple[float, float]]) -> list[int]:
    """Index of the place nearest to each board."""
    return [int(np.linalg.norm(places_mm - np.array(board), axis=1).argmin()) for board in boards_mm]


def _variances(information: np.ndarray) -> np.ndarray:
    """(..., L, 3) of direction, log speed and offset, of information (..., L, 5, 5)."""
    inverse = np.linalg.inv(with_gain_prior(information))
    return np.diagonal(inverse, axis1=-2, axis2=-1)[..., :ERRORS]


def response_of(field: TiltField, sensor: Sensor) -> ResponseMap:
    """The map of boards at all places, two channels each."""
    half = half_of(sensor.chamber_mm)
    x, y = spline_grid(half)
    volts = sensor.accelerometers[0].sensitivity_v_per_g * field.parts
    surfaces = []
    for part in range(PARTS):
        flat = volts[part].reshape(len(field.x_mm), len(field.y_mm), -1)
        at = RegularGridInterpolator((field.x_mm, field.y_mm), flat, bounds_error=False, fill_value=0.0)
        surfaces.append(spline_coefficients(at((x, y)), half))
    coefficients = np.stack(surfaces)
    return ResponseMap(coefficients, np.zeros_like(surfaces[0]), sensor.chamber_mm, CENTRE_MM, field.depth_mm)

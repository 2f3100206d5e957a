"""Where to put the accelerometers: the places whose Cramer-Rao bound over the skin is least.

For lines drawn all over the chamber, each place's readings give Fisher information on direction, log speed, offset,
place along the line and log gain (Kay 1993, chapter 3), with the static outputs unknown. Boards are taken not to
disturb each other, so that their information adds; the bound of a set is the inverse of the sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from features.errors import InputError
from models.response_map.from_atlas import DESIGN_DRIFT_V, DESIGN_NOISE_V, GRID_MM, SAMPLE_MM
from models.response_map.map import MARGIN_MM, PARTS, ResponseMap, spline_coefficients
from models.response_map.plan import BLOCK_S, GAIN_SD, LEAST_CHORD_MM, LINE_SPEED_MM_S, STEPS
from models.response_map.spline_fit import MAP_VARIANCE
from pipeline.atlas.bare_skin import TiltField
from pipeline.sensor import Sensor

LINES = 300  # that the bound is averaged over
GAP_MM = 0.5  # of skin between two boards
ERRORS = 3  # direction, log speed and offset, of the five that are estimated
SWEEPS = 5  # of exchanges; on the article's skin the third changes nothing
LEAST_GAIN = 1e-6  # of the criterion, below which an exchange is none


@dataclass(frozen=True)
class Lines:
    """Lines over the chamber: direction_rad, offset_mm (from the chamber's centre), each (L,), and the places (mm) that
    each passes, (n, 2)."""

    direction_rad: np.ndarray
    offset_mm: np.ndarray
    passed_mm: list[np.ndarray]


@dataclass(frozen=True)
class Arrangement:
    """places_mm: (boards, 2). deviations: (3, L), bounds of direction (rad), log speed and offset (mm) of each line."""

    places_mm: np.ndarray
    deviations: np.ndarray


def draw_lines(chamber_mm: tuple[float, float], seed: int = 0) -> Lines:
    """Any direction and offset alike, with at least LEAST_CHORD_MM over the chamber."""
    random, half = np.random.default_rng(seed), np.array(chamber_mm) / 2
    way = np.arange(-half.sum(), half.sum(), SAMPLE_MM)
    directions: list[float] = []
    offsets: list[float] = []
    passed: list[np.ndarray] = []
    while len(passed) < LINES:
        direction, offset = random.uniform(0, 2 * np.pi), random.uniform(-1, 1) * max(half)
        places = _places(direction, offset, way)
        over = (np.abs(places) < half).all(axis=1)
        if over.sum() * SAMPLE_MM >= LEAST_CHORD_MM:
            directions.append(direction)
            offsets.append(offset)
            passed.append(places[over])
    return Lines(np.array(directions), np.array(offsets), passed)


def information(field: TiltField, sensor: Sensor, lines: Lines) -> np.ndarray:
    """(P, L, 5, 5): what a board at each place tells of each line, passed as a whole at LINE_SPEED_MM_S."""
    response = _response(field, sensor)
    blocks = SAMPLE_MM / LINE_SPEED_MM_S / BLOCK_S
    variance = DESIGN_NOISE_V**2 * (1 / blocks + MAP_VARIANCE)
    told = np.empty((len(field.places_mm), len(lines.passed_mm), len(STEPS), len(STEPS)))
    for n, passed in enumerate(lines.passed_mm):
        slopes = _slopes(response, lines.direction_rad[n], lines.offset_mm[n], passed)
        jacobian = slopes.reshape(len(passed), len(field.places_mm), 2, len(STEPS))
        total = jacobian.sum(axis=0)
        # A static output of its own in each channel, known to the drift: its information is taken out.
        lost = np.einsum("pcj,pck->pjk", total, total) / (len(passed) + variance / DESIGN_DRIFT_V**2)
        kept = np.einsum("npcj,npck->pjk", jacobian, jacobian, optimize=True)
        told[:, n] = (kept - lost) / variance
    return told


def best_places(
    places_mm: np.ndarray, told: np.ndarray, boards: int, board_mm: tuple[float, float]
) -> Arrangement:
    """The set of so many boards that do not overlap with the least criterion: chosen one by one, then exchanged.

    Raises:
        InputError: so many boards do not fit.
    """
    chosen: list[int] = []
    for _ in range(boards):
        one, least = _best(places_mm, told, chosen, board_mm)
        if one < 0:
            raise InputError(f"{boards}: only {len(chosen)} such boards fit the chamber", "boards")
        chosen.append(one)
    for _ in range(SWEEPS):
        before = list(chosen)
        for k in range(boards):
            others = chosen[:k] + chosen[k + 1 :]
            one, value = _best(places_mm, told, others, board_mm)
            if value < least - LEAST_GAIN:
                chosen[k], least = one, value
        if chosen == before:
            break
    return arrangement(places_mm[chosen], told[chosen].sum(axis=0))


def arrangement(places_mm: np.ndarray, told: np.ndarray) -> Arrangement:
    """The bound of boards at these places, of their information (L, 5, 5)."""
    return Arrangement(places_mm, np.sqrt(_variances(told)).T)


def nearest_places(places_mm: np.ndarray, boards_mm: Sequence[tuple[float, float]]) -> list[int]:
    """Index of the place nearest to each board."""
    return [int(np.linalg.norm(places_mm - np.array(board), axis=1).argmin()) for board in boards_mm]


def _best(
    places_mm: np.ndarray, told: np.ndarray, taken: Sequence[int], board_mm: tuple[float, float]
) -> tuple[int, float]:
    """The place that, beside those taken, leaves the least criterion, and that; -1 where none is free."""
    free = np.ones(len(places_mm), bool)
    for one in taken:
        apart = np.abs(places_mm - places_mm[one]) >= np.array(board_mm) + GAP_MM
        free &= apart.any(axis=1)
    if not free.any():
        return -1, np.inf
    values = np.full(len(places_mm), np.inf)
    base = told[list(taken)].sum(axis=0)
    for one in np.flatnonzero(free).tolist():
        values[one] = np.log(_variances(base + told[one]).mean(axis=0)).sum()
    return int(values.argmin()), float(values.min())


def _variances(told: np.ndarray) -> np.ndarray:
    """(L, 3) of direction, log speed and offset, of information (L, 5, 5)."""
    prior = np.zeros(len(STEPS))
    prior[-1] = GAIN_SD**-2
    inverse = np.linalg.inv(told + np.diag(prior))
    return np.diagonal(inverse, axis1=-2, axis2=-1)[:, :ERRORS]


def _slopes(response: ResponseMap, direction: float, offset: float, passed: np.ndarray) -> np.ndarray:
    """(n, C, 5) V by direction (rad), log speed, offset (mm), place along the line (mm) and log gain."""
    along = passed @ np.array([np.cos(direction), np.sin(direction)])

    def volts(change: np.ndarray) -> np.ndarray:
        turn, log_speed, aside, ahead, log_gain = change
        way = along[-1] + ahead - (along[-1] - along) * np.exp(log_speed)
        places = _places(direction + turn, offset + aside, way)
        return np.exp(log_gain) * response.response(places[:, 0], places[:, 1], direction + turn)

    each = [(volts(step) - volts(-step)) / (2 * step.sum()) for step in np.diag(STEPS)]
    return np.stack(each, axis=-1)


def _places(direction: float, offset: float, way: np.ndarray) -> np.ndarray:
    """(n, 2) mm: the places along a line, from its foot as seen from the chamber's centre."""
    cos, sin = np.cos(direction), np.sin(direction)
    return offset * np.array([-sin, cos]) + way[:, None] * np.array([cos, sin])


def _response(field: TiltField, sensor: Sensor) -> ResponseMap:
    """The map of boards at all places, two channels each."""
    half = max(sensor.chamber_mm) / 2 + MARGIN_MM
    grid = np.arange(-half, half + GRID_MM / 2, GRID_MM)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    volts = sensor.accelerometers[0].sensitivity_v_per_g * field.parts
    surfaces = []
    for part in range(PARTS):
        flat = volts[part].reshape(len(field.x_mm), len(field.y_mm), -1)
        at = RegularGridInterpolator((field.x_mm, field.y_mm), flat, bounds_error=False, fill_value=0.0)
        surfaces.append(spline_coefficients(at((x, y)), grid, half))
    coefficients = np.stack(surfaces)
    return ResponseMap(
        coefficients, np.zeros_like(surfaces[0]), sensor.chamber_mm, (0.0, 0.0), field.depth_mm
    )

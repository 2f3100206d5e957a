"""The Fisher information (Kay 1993, chapter 3) of readings along a straight line, by which designs are judged.

A line is estimated by least squares over five numbers, STEPS, and the static output of each channel. Sets of slides, or
of boards, are built up one by one, then exchanged while that helps (Fedorov 1972).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.calibrate import MAP_VARIANCE
from softslide.models.response_map.from_atlas import SAMPLE_MM
from softslide.models.response_map.map import ResponseMap

LINE_SPEED_MM_S = 2.0  # of the lines: the middle of the article's speeds; it weighs with the lag alone
LEAST_CHORD_MM = 20.0  # over the chamber; shorter lines are at its corners
GAIN_SD = 0.02  # of a slide that is estimated, as calibrations find it (ResponseMap.gain_sd)
# Of the differences in direction (rad), log speed, offset (mm), place along the line (mm) and log gain.
STEPS = np.array([0.01, 0.01, 0.1, 0.1, 0.01])
ERRORS = 3  # direction, log speed and offset; what else is fitted does not count
LEAST_GAIN = 1e-6  # of the criterion, below which nothing is exchanged


@dataclass(frozen=True)
class Line:
    """A line over the chamber: direction_rad, offset_mm, and places on it (n,), mm from its foot, SAMPLE_MM apart."""

    direction_rad: float
    offset_mm: float
    along_mm: np.ndarray


def draw_lines(
    chamber_mm: tuple[float, float],
    reference_mm: tuple[float, float],
    count: int,
    random: np.random.Generator,
) -> Iterator[Line]:
    """Any direction and offset alike, with at least LEAST_CHORD_MM over the chamber."""
    half = np.array(chamber_mm) / 2
    along = np.arange(-2 * half.sum(), 2 * half.sum(), SAMPLE_MM)
    while count:
        direction, offset = random.uniform(0, 2 * np.pi), random.uniform(-1, 1) * max(half)
        over = (np.abs(places(reference_mm, direction, offset, along)) < half[:, None]).all(axis=0)
        if over.sum() * SAMPLE_MM >= LEAST_CHORD_MM:
            yield Line(direction, offset, along[over])
            count -= 1


def places(
    reference_mm: tuple[float, float], direction_rad: float, offset_mm: float, along_mm: np.ndarray
) -> np.ndarray:
    """(2, n) mm: places along a line, counted from the foot of the reference point's perpendicular."""
    cos, sin = np.cos(direction_rad), np.sin(direction_rad)
    foot = np.array(reference_mm) + offset_mm * np.array([-sin, cos])
    return foot[:, None] + np.array([cos, sin])[:, None] * along_mm


def slopes(response: ResponseMap, line: Line) -> np.ndarray:
    """(n, C, 5) V: the output's derivatives by direction (rad), log speed, offset (mm), place (mm) and log gain."""
    along = line.along_mm

    def volts(change: np.ndarray) -> np.ndarray:
        turn, log_speed, aside, ahead, log_gain = change
        way = along[-1] + ahead - (along[-1] - along) * np.exp(log_speed)
        direction = line.direction_rad + turn
        x, y = places(response.reference_mm, direction, line.offset_mm + aside, way)
        return np.exp(log_gain) * response.response(x, y, direction)

    each = [(volts(step) - volts(-step)) / (2 * step.sum()) for step in np.diag(STEPS)]
    return np.stack(each, axis=-1)


def reading_variance(noise_v: float) -> float:
    """V^2, of the mean over SAMPLE_MM at LINE_SPEED_MM_S: a block's noise, and the map's own residual."""
    blocks = SAMPLE_MM / LINE_SPEED_MM_S / Conditioning.block_s
    return noise_v**2 * (1 / blocks + MAP_VARIANCE)


def without_static(jacobian: np.ndarray, zero_v: np.ndarray | float, variance: float) -> np.ndarray:
    """Derivatives (n, C, 5) less what a static output of each channel, known to within zero_v (V), takes from them.

    J' of these times J over the variance is the information that is left.
    """
    known = variance / np.broadcast_to(zero_v, jacobian.shape[1:2]) ** 2
    return jacobian - jacobian.sum(axis=0) / (len(jacobian) + known)[:, None]


def with_gain_prior(information: np.ndarray) -> np.ndarray:
    """Information (..., 5, 5) with that of a gain known to GAIN_SD."""
    return information + np.diag([0.0, 0.0, 0.0, 0.0, GAIN_SD**-2])


def criterion(variances: np.ndarray) -> np.ndarray:
    """What a design makes small, of variances (..., L, 3): the product over direction, speed and offset of the mean
    variance, as a logarithm, so that their units do not matter."""
    return np.log(variances.mean(axis=-2)).sum(axis=-1)


def exchanged(best: Callable[[list[int]], tuple[int, float]], steps: Sequence[int], sweeps: int) -> list[int]:
    """A set of as many as there are steps: chosen one by one, then exchanged while that helps.

    best: which one more leaves the least criterion next to those given, and that.
    """
    chosen: list[int] = []
    for _ in steps:
        one, least = best(chosen)
        chosen.append(one)
    for _ in range(sweeps):
        before = list(chosen)
        for place in range(len(chosen)):
            others = chosen[:place] + chosen[place + 1 :]
            one, value = best(others)
            if value < least - LEAST_GAIN:
                chosen[place], least = one, value
        if chosen == before:
            break
    return chosen

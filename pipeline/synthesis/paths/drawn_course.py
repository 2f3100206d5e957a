"""Courses drawn at random: straight or bent, in over the rim and out again."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.lines import reach_mm
from softslide.pipeline.synthesis.distribution import log_uniform
from softslide.pipeline.synthesis.paths.course import STEP_MM, Course
from softslide.pipeline.synthesis.paths.distribution import PathDistribution
from softslide.pipeline.synthesis.slide_plan import CLEAR_MM, crossing

CURVES = ("arc", "s", "circle", "corner", "smooth")
# Turns of the heading, rad, as a function of the way, mm.
Turns = Callable[[np.ndarray], np.ndarray]
# No course is longer: a circle between two straight ways is about 110 mm.
_LONGEST_MM = 140.0


class NoCourse(Exception):
    """What was drawn is not a course over the skin."""


@dataclass(frozen=True)
class Draw:
    """What a path is drawn from."""

    paths: PathDistribution
    sensor: Sensor
    atlas: Atlas
    height_mm: float
    depth_mm: float
    random: np.random.Generator

    @property
    def clear_mm(self) -> float:
        """A depth at which the indenter touches nothing: above the skin's highest point."""
        return -self.height_mm - CLEAR_MM

    def log_uniform(self, bounds: tuple[float, float]) -> float:
        return log_uniform(self.random, bounds)

    def reach(self) -> np.ndarray:
        """Half sizes (2,) mm beyond which motion begins and ends."""
        return np.array(reach_mm(self.sensor)) + CLEAR_MM

    def inner(self) -> np.ndarray:
        """A place (2,) mm well on the skin."""
        half = self.paths.inner_share * np.array(self.sensor.chamber_mm) / 2
        return self.random.uniform(-half, half)


def rim_to_rim(draw: Draw, curve: str | None = None) -> Course:
    """A course from clear of the skin to clear of it again.

    curve: one of `CURVES`; None is straight, half of them along the axes.

    Raises:
        NoCourse: what was drawn is not one.
    """
    random, sensor = draw.random, draw.sensor
    along_axis = curve is None and random.uniform() < 0.5
    direction = 90.0 * random.integers(4) if along_axis else random.uniform(0, 360)
    aside = draw.paths.inner_share * min(sensor.chamber_mm) / 2
    line = crossing(direction, random.uniform(-aside, aside), sensor)
    if line is None:
        raise NoCourse
    start, _, _ = line
    way = STEP_MM * (np.arange(round(_LONGEST_MM / STEP_MM)) + 0.5)
    turns, whole_turn = (None, 0.0) if curve is None else _turns(draw, curve)
    heading = np.deg2rad(direction) + (np.zeros(len(way)) if turns is None else turns(way))
    course = Course(start, heading, np.full(len(way) + 1, draw.depth_mm))
    distance = np.abs(course.places())
    # The start itself lies on the boundary, give or take its rounding.
    out = (distance > draw.reach() + 1e-6).any(axis=1)
    if not out.any():
        raise NoCourse
    end = int(out.argmax()) - 1
    over = (distance[:end] < np.array(sensor.chamber_mm) / 2).all(axis=1)
    turned = float(np.ptp(heading[:end][over])) if over.any() else 0.0
    if STEP_MM * over.sum() < draw.paths.chord_mm or turned < whole_turn - 1e-3:
        raise NoCourse
    return Course(start, heading[:end], course.depth_mm[: end + 1])


def _turns(draw: Draw, name: str) -> tuple[Turns, float]:
    """How a curve's heading turns, and by how much, rad, it is to turn over the chamber for its name's sake."""
    random, paths = draw.random, draw.paths
    sign = random.choice([-1.0, 1.0])
    # Where the bend of a course begins or changes: a quarter to a half of a way across.
    at = random.uniform(0.25, 0.6) * draw.sensor.chamber_mm[0]
    if name == "arc":
        radius = draw.log_uniform(paths.radius_mm)
        return lambda way: sign * way / radius, 0.0
    if name == "s":
        radius = draw.log_uniform(paths.radius_mm)
        return lambda way: sign * (at - np.abs(way - at)) / radius, 0.0
    if name == "circle":
        radius = paths.circle_mm
        return lambda way: sign * np.clip(way - at, 0, 2 * np.pi * radius) / radius, 2 * np.pi
    if name == "corner":
        corner = np.deg2rad(random.uniform(*paths.corner_deg))
        return lambda way: sign * corner * (way > at), corner
    lengths, phases = random.uniform(*paths.wave_mm, 3)[:, None], random.uniform(0, 2 * np.pi, 3)[:, None]

    def smooth(way: np.ndarray) -> np.ndarray:
        curvature = np.cos(2 * np.pi * way / lengths + phases).mean(axis=0) / paths.bend_mm
        return np.cumsum(curvature) * STEP_MM

    return smooth, 0.0


def way_out(place: np.ndarray, heading: float, half: np.ndarray) -> float:
    """Way in mm from a place inside +-half to its boundary."""
    along = np.array([np.cos(heading), np.sin(heading)])
    return float(((half - np.sign(along) * place) / np.maximum(np.abs(along), 1e-12)).min())

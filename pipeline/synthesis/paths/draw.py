"""Paths of each kind, drawn at random."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.distribution import Distribution, draw_pressure
from softslide.pipeline.synthesis.paths.contact_path import ContactPath, Timing
from softslide.pipeline.synthesis.paths.course import STEP_MM, Course
from softslide.pipeline.synthesis.paths.distribution import PathDistribution
from softslide.pipeline.synthesis.paths.drawn_course import CURVES, Draw, NoCourse, rim_to_rim, way_out
from softslide.pipeline.synthesis.slide_plan import near_failure

_DRAWS = 500


def draw_path(
    number: int,
    atlas: Atlas,
    sensor: Sensor,
    distribution: Distribution,
    random: np.random.Generator,
    paths: PathDistribution | None = None,
    kind: str | None = None,
) -> ContactPath:
    """The plan of path `number`, counted from 0, of its place's kind in `KINDS` unless one is named.

    distribution: of depth, pressure, posture and repeatability, as of slides.

    Raises:
        InputError: no path of the kind stays clear of places that were not solved, or as `draw_pressure`.
    """
    paths, kind = paths or PathDistribution(), kind or KINDS[number % len(KINDS)]
    share, height = draw_pressure(atlas, distribution, random)
    uneven = random.uniform() < distribution.uneven
    off = distribution.off_mm * random.uniform(-1, 1) if uneven else 0.0
    depth = float(np.clip(distribution.depth_mm + off, atlas.depth_mm[0], atlas.depth_mm[-1]))
    for _ in range(_DRAWS):
        with suppress(NoCourse):
            drawn = _OF_KIND[kind](Draw(paths, sensor, atlas, height, depth, random))
            if not near_failure(atlas, *drawn["course"].places()[:: round(0.5 / STEP_MM)].T):
                break
    else:
        raise InputError(f"no path of kind {kind} fits over solved positions; name another atlas")
    posture = distribution.posture_deg * random.standard_normal(2)
    return ContactPath(
        height_mm=height,
        pressure_mpa=sensor.pressure_mpa * share,
        kind=kind,
        indenter_mm=sensor.indenter_diameter_mm,
        name=f"p{number:05d}",
        motion_start_s=float(random.uniform(*paths.before_s)),
        rest_after_s=float(random.uniform(*paths.after_s)),
        posture_deg=(float(posture[0]), float(posture[1])),
        gain=1 + distribution.repeatability * random.standard_normal(),
        friction_mm=float(random.uniform(*paths.friction_mm)),
        **drawn,
    )


def _line(draw: Draw) -> dict:
    return _straight_at_one_speed(draw, rim_to_rim(draw))


def _curve(draw: Draw) -> dict:
    drawn = _bent(draw)
    return drawn | _at_one_speed(draw, drawn["course"])


def _speed(draw: Draw) -> dict:
    drawn = _straight_or_bent(draw)
    slow, quick = draw.log_uniform(draw.paths.slow_mm_s), draw.log_uniform(draw.paths.quick_mm_s)
    share = np.linspace(0, 1, len(drawn["course"].way_mm))
    if draw.random.uniform() < 0.5:
        # At constant acceleration the speed's square is a straight line of the way.
        speed = np.sqrt(slow**2 + (quick**2 - slow**2) * (1 - np.abs(2 * share - 1)))
        law = "accel"
    else:
        waves = draw.random.uniform(*draw.paths.changes, 3)
        turns = draw.random.uniform(0, 1, 3)
        wave = np.cos(2 * np.pi * (waves[:, None] * share + turns[:, None])).sum(axis=0)
        part = (wave - wave.min()) / max(float(np.ptp(wave)), 1e-9)
        speed, law = slow * (quick / slow) ** part, "random"
    return drawn | {"law": law, "timing": Timing(_ramped(draw, drawn["course"], speed))}


def _stop(draw: Draw) -> dict:
    drawn = _straight_or_bent(draw)
    course = drawn["course"]
    at = int(draw.random.uniform(0.3, 0.7) * len(course.heading_rad))
    speed = _ramped(draw, course, draw.log_uniform(draw.paths.speed_mm_s), at)
    return drawn | {"law": "stop", "timing": Timing(speed, ((at, draw.paths.stop_s),))}


def _reverse(draw: Draw) -> dict:
    """In over the rim, and back on the same line to where it came from."""
    course = rim_to_rim(draw)
    at = int(draw.random.uniform(0.4, 0.75) * len(course.heading_rad))
    heading = np.repeat([course.heading_rad[0], course.heading_rad[0] + np.pi], at)
    course = Course(course.start_mm, heading, np.full(2 * at + 1, draw.depth_mm))
    speed = draw.log_uniform(draw.paths.speed_mm_s)
    rest = float(draw.random.uniform(*draw.paths.turn_s))
    timing = Timing(_ramped(draw, course, speed, at), ((at, rest),))
    return {"shape": "line", "law": "constant", "course": course, "timing": timing, "depth_mm": draw.depth_mm}


def _touchdown(draw: Draw) -> dict:
    """Down on the skin, and out over the rim."""
    heading = draw.random.uniform(0, 2 * np.pi)
    start = draw.inner()
    return _on_or_off(draw, start, heading, way_out(start, heading, draw.reach()), down=True)


def _lift(draw: Draw) -> dict:
    """In over the rim, and up on the skin."""
    end, heading = draw.inner(), draw.random.uniform(0, 2 * np.pi)
    from_rim = way_out(end, heading + np.pi, draw.reach())
    start = end - from_rim * np.array([np.cos(heading), np.sin(heading)])
    return _on_or_off(draw, start, heading, from_rim, down=False)


def _depth(draw: Draw) -> dict:
    course = rim_to_rim(draw)
    change = draw.random.choice([-1, 1]) * draw.random.uniform(*draw.paths.change_mm)
    middle = 0.5 * len(course.heading_rad)
    depth = draw.depth_mm + change * (np.arange(len(course.way_mm)) / middle - 1)
    # Neither pulled off the flat skin's face nor beyond what the atlas holds.
    depth = np.clip(depth, 0.0, draw.atlas.depth_mm[-1])
    drawn = _straight_at_one_speed(draw, Course(course.start_mm, course.heading_rad, depth))
    return drawn | {"depth_mm": np.nan}


def _press(draw: Draw) -> dict:
    x, y = draw.inner()
    course = Course((float(x), float(y)), np.zeros(0), np.array([draw.depth_mm]))
    fall = (draw.depth_mm - draw.clear_mm) / draw.log_uniform(draw.paths.fall_mm_s)
    hold = float(draw.random.uniform(*draw.paths.hold_s))
    timing = Timing(np.zeros(1), (), draw.clear_mm, down_s=fall, up_s=fall, settle_s=hold / 2)
    return {"shape": "press", "law": "press", "course": course, "timing": timing}


_OF_KIND: dict[str, Callable[[Draw], dict]] = {
    "line": _line,
    "curve": _curve,
    "speed": _speed,
    "stop": _stop,
    "reverse": _reverse,
    "touchdown": _touchdown,
    "lift": _lift,
    "depth": _depth,
    "press": _press,
}
# The kinds of successive paths, again and again: equal shares of any nine.
KINDS = tuple(_OF_KIND)


def _bent(draw: Draw) -> dict:
    name = str(draw.random.choice(CURVES))
    return {"shape": name, "course": rim_to_rim(draw, name), "depth_mm": draw.depth_mm}


def _straight(draw: Draw, course: Course) -> dict:
    """With its direction and offset."""
    angle, (x, y), (x_ref, y_ref) = course.heading_rad[0], course.start_mm, draw.sensor.reference_mm
    return {
        "shape": "line",
        "course": course,
        "depth_mm": draw.depth_mm,
        "direction_deg": float(np.rad2deg(angle)),
        "offset_mm": float(signed_offset(angle, x - x_ref, y - y_ref)),
    }


def _straight_or_bent(draw: Draw) -> dict:
    """A course without its timing, straight as often as bent."""
    return _bent(draw) if draw.random.uniform() >= 0.5 else _straight(draw, rim_to_rim(draw))


def _straight_at_one_speed(draw: Draw, course: Course) -> dict:
    timed = _at_one_speed(draw, course)
    return _straight(draw, course) | timed | {"speed_mm_s": float(timed["timing"].speed_mm_s.max())}


def _on_or_off(draw: Draw, start: np.ndarray, heading: float, travel: float, down: bool) -> dict:
    """A straight course that begins (down) or ends on the skin, vertically or along a slant."""
    random, paths = draw.random, draw.paths
    if travel < paths.on_skin_mm:
        raise NoCourse
    count = int(travel / STEP_MM)
    depth = np.full(count + 1, draw.depth_mm)
    course = Course((float(start[0]), float(start[1])), np.full(count, heading), depth)
    name = "touchdown" if down else "lift"
    clear, fall, settle = 0.0, 0.0, 0.0
    if slanted := random.uniform() < 0.5:
        slant = min(random.uniform(*paths.slant_mm), 0.6 * travel)
        left = course.way_mm if down else course.travel_mm - course.way_mm
        depth[:] = draw.depth_mm + (draw.clear_mm - draw.depth_mm) * np.clip(1 - left / slant, 0, 1)
    else:
        fall = (draw.depth_mm - draw.clear_mm) / draw.log_uniform(paths.fall_mm_s)
        clear, settle = draw.clear_mm, float(random.uniform(*paths.settle_s))
    speed = _ramped(draw, course, draw.log_uniform(paths.speed_mm_s))
    return {
        "shape": f"{name}-{'slanted' if slanted else 'vertical'}",
        "law": "constant",
        "course": course,
        "timing": Timing(speed, (), clear, fall if down else 0.0, 0.0 if down else fall, settle),
        "depth_mm": draw.depth_mm,
    }


def _at_one_speed(draw: Draw, course: Course) -> dict:
    speed = draw.log_uniform(draw.paths.speed_mm_s)
    return {"law": "constant", "timing": Timing(_ramped(draw, course, speed))}


def _ramped(draw: Draw, course: Course, speed: np.ndarray | float, stop: int | None = None) -> np.ndarray:
    """Speeds (n + 1,) mm/s with a ramp of constant acceleration at either end, and about the knot of a stop."""
    knots = np.arange(len(course.heading_rad) + 1)
    speed = np.broadcast_to(speed, len(knots))
    to_stop = np.minimum(knots, knots[-1] - knots)
    if stop is not None:
        to_stop = np.minimum(to_stop, np.abs(knots - stop))
    acceleration = speed.max() / draw.random.uniform(*draw.paths.ramp_s)
    return np.minimum(speed, np.sqrt(2 * acceleration * STEP_MM * to_stop))

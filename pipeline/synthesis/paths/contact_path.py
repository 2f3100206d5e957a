"""The plan of one contact: where the indenter is at any time, how deep, and what the manifest says of it.

A path is a list of knots in time. Between two knots the heading is constant, the acceleration is constant, and the
depth is a straight line in time; place and speed follow from these exactly.
"""

from dataclasses import dataclass

import numpy as np

from softslide.pipeline.synthesis.paths.course import STEP_MM, Course


@dataclass(frozen=True)
class Timing:
    """When: speeds (n + 1,) mm/s at the course's knots, rests on the way, and the ways down and up at its ends.

    rests: (knot, s) pairs. down_s, up_s: duration of a vertical way from `clear_mm` to the course's first depth and
    back, 0 for none; settle_s: rest after the one and before the other.
    """

    speed_mm_s: np.ndarray
    rests: tuple[tuple[int, float], ...] = ()
    clear_mm: float = 0.0
    down_s: float = 0.0
    up_s: float = 0.0
    settle_s: float = 0.0


@dataclass(frozen=True)
class Moments:
    """A path at (n,) times: place mm, velocity mm/s, depth mm, friction's direction; each (n,) or (n, 2)."""

    place_mm: np.ndarray
    velocity_mm_s: np.ndarray
    depth_mm: np.ndarray
    friction: np.ndarray


@dataclass(frozen=True)
class ContactPath:
    """The plan of one contact; labels that have no meaning for its kind are nan."""

    course: Course
    timing: Timing
    height_mm: float
    pressure_mpa: float
    kind: str
    shape: str
    law: str
    indenter_mm: float
    name: str = "path"
    motion_start_s: float = 2.0
    rest_after_s: float = 2.0
    posture_deg: tuple[float, float] = (0.0, 0.0)
    gain: float = 1.0
    friction_mm: float = 0.3
    direction_deg: float = np.nan
    speed_mm_s: float = np.nan
    offset_mm: float = np.nan
    depth_mm: float = np.nan

    @property
    def split(self) -> str:
        """For reporting alone: nothing is fitted to `track-*`."""
        return f"track-{self.kind}"

    @property
    def motion_end_s(self) -> float:
        """When the indenter, down and up included, comes to its last rest."""
        return float(self.knots()[0][-1])

    @property
    def duration_s(self) -> float:
        """The whole recording's."""
        return self.motion_end_s + self.rest_after_s

    @property
    def quickest_mm_s(self) -> float:
        """The highest speed, along the skin or down."""
        time, _, depth = self.knots()
        step = np.diff(time)
        fall = np.abs(np.diff(depth))[step > 0] / step[step > 0]
        return float(max(self.timing.speed_mm_s.max(initial=0.0), fall.max(initial=0.0)))

    def labels(self) -> dict[str, float | str]:
        """The manifest's row."""
        return {
            "recording": self.name,
            "split": self.split,
            "direction_deg": self.direction_deg,
            "speed_mm_s": self.speed_mm_s,
            "offset_mm": self.offset_mm,
            "start_x_mm": self.course.start_mm[0],
            "start_y_mm": self.course.start_mm[1],
            "travel_mm": self.course.travel_mm or np.nan,
            "depth_mm": self.depth_mm,
            "pressure_mpa": self.pressure_mpa,
            "motion_start_s": self.motion_start_s,
            "motion_end_s": self.motion_end_s,
            "height_mm": self.height_mm,
            "path": self.shape,
            "law": self.law,
            "indenter_mm": self.indenter_mm,
        }

    def knots(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time s, the course's knot, and depth mm at each knot in time (m,)."""
        course, timing = self.course, self.timing
        v = timing.speed_mm_s
        count = len(course.heading_rad)
        # At constant acceleration a step takes its length over the mean of the speeds at its ends.
        took = 2 * STEP_MM / (v[:-1] + v[1:])
        time = np.concatenate([[0.0], np.cumsum(took)])
        knots = np.stack([time, np.arange(count + 1), course.depth_mm])
        for at, rest_s in sorted(timing.rests, reverse=True):
            knots = np.insert(knots, at + 1, knots[:, at], axis=1)
            knots[0, at + 1 :] += rest_s
        if timing.down_s:
            knots[0] += timing.down_s + timing.settle_s
            down = np.array([[0.0, timing.down_s], [0, 0], [timing.clear_mm, course.depth_mm[0]]])
            knots = np.hstack([down, knots])
        if timing.up_s:
            rises_s = knots[0, -1] + timing.settle_s
            ends = [course.depth_mm[-1], timing.clear_mm]
            up = np.array([[rises_s, rises_s + timing.up_s], [count, count], ends])
            knots = np.hstack([knots, up])
        return self.motion_start_s + knots[0], knots[1].astype(int), knots[2]

    def at(self, time_s: np.ndarray) -> Moments:
        """The path at (n,) s."""
        time, knot, depth = self.knots()
        course, v = self.course, self.timing.speed_mm_s
        places, friction = course.places(), course.friction(self.friction_mm)
        inside = np.clip(time_s, time[0], time[-1])
        low = np.clip(np.searchsorted(time, inside, side="right") - 1, 0, len(time) - 2)
        took = np.maximum(time[low + 1] - time[low], 1e-12)
        since = inside - time[low]
        share = since / took
        moving = knot[low + 1] > knot[low]
        first, heading = knot[low], np.append(course.heading_rad, 0.0)[knot[low]]
        v0, v1 = (np.where(moving, v[np.minimum(first + k, len(v) - 1)], 0.0) for k in (0, 1))
        way = v0 * since + (v1 - v0) * since * share / 2
        along = np.column_stack([np.cos(heading), np.sin(heading)])
        held = (time_s <= time[0]) | (time_s >= time[-1])
        speed = np.where(held, 0.0, v0 + (v1 - v0) * share)
        part = np.where(moving, share, 0.0)[:, None]
        after = np.minimum(first + 1, len(places) - 1)
        return Moments(
            places[first] + way[:, None] * along,
            speed[:, None] * along + 0.0,
            depth[low] + share * (depth[low + 1] - depth[low]),
            (1 - part) * friction[first] + part * friction[after],
        )

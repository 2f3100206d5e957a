"""The plan of one slide: its line, its motion, its contact, and what the manifest says of it."""

from dataclasses import dataclass

import numpy as np

from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.lines import reach_mm
from softslide.pipeline.synthesis.motion import Stroke

# Motion begins and ends this far outside of where the indenter can touch the skin.
CLEAR_MM = 1.0


@dataclass(frozen=True)
class Slide:
    """The plan of one slide, in the manifest's terms and beyond."""

    direction_deg: float
    offset_mm: float
    start_mm: tuple[float, float]
    stroke: Stroke
    depth_mm: float  # at the middle of the first stroke
    pressure_mpa: float  # the regulator's
    height_mm: float  # the skin's, which the atlas goes by
    depth_slope: float = 0.0  # mm per mm of way
    name: str = "slide"
    split: str = "train"
    motion_start_s: float = 2.0
    rest_after_s: float = 2.0
    posture_deg: tuple[float, float] = (0.0, 0.0)  # the sensor's tilt towards x and towards y
    gain: float = 1.0  # of the response

    @property
    def duration_s(self) -> float:
        """The whole recording's."""
        return self.motion_start_s + self.stroke.duration_s + self.rest_after_s

    @property
    def quickest_mm_s(self) -> float:
        """The highest speed."""
        return self.stroke.speed_mm_s

    def labels(self) -> dict[str, float | str]:
        """The manifest's row, of the first stroke."""
        return {
            "recording": self.name,
            "split": self.split,
            "direction_deg": self.direction_deg,
            "speed_mm_s": self.stroke.speed_mm_s,
            "offset_mm": self.offset_mm,
            "start_x_mm": self.start_mm[0],
            "start_y_mm": self.start_mm[1],
            "travel_mm": self.stroke.travel_mm,
            "depth_mm": self.depth_mm,
            "pressure_mpa": self.pressure_mpa,
            "motion_start_s": self.motion_start_s,
            "motion_end_s": self.motion_start_s + self.stroke.forth_s,
            "depth_change_mm": self.depth_slope * self.stroke.travel_mm + 0.0,
            "height_mm": self.height_mm,
            "back_mm": self.stroke.back_mm,
        }

    def places(self, way_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and y (n,) mm of the indenter's centre after (n,) mm of way."""
        return on_line(self.start_mm, self.direction_deg, way_mm)

    def depths(self, way_mm: np.ndarray) -> np.ndarray:
        """(n,) mm below the flat skin's face after (n,) mm of way."""
        return self.depth_mm + self.depth_slope * (way_mm - self.stroke.travel_mm / 2)


def on_line(
    start_mm: tuple[float, float], direction_deg: float, way_mm: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """x and y (n,) mm after (n,) mm of way along a direction."""
    angle = np.deg2rad(direction_deg)
    return start_mm[0] + np.cos(angle) * way_mm, start_mm[1] + np.sin(angle) * way_mm


def crossing(
    direction_deg: float, offset_mm: float, sensor: Sensor
) -> tuple[tuple[float, float], float, float] | None:
    """Where on a line motion begins, mm, its way, and how much of it is over the chamber; None if it misses.

    It begins and ends clear of where the indenter can touch the skin.
    """
    reach = np.array(reach_mm(sensor)) + CLEAR_MM
    angle = np.deg2rad(direction_deg)
    # Sines of whole right angles are to be exact zeros: a start has no digits of rounding.
    along = np.round([np.cos(angle), np.sin(angle)], 15)
    foot = np.array(sensor.reference_mm) + offset_mm * np.array([-along[1], along[0]])
    outer, inner = (chord(foot, along, half) for half in (reach, np.array(sensor.chamber_mm) / 2))
    if outer is None or inner is None:
        return None
    x, y = foot + outer[0] * along + 0.0
    return (float(x), float(y)), outer[1] - outer[0], inner[1] - inner[0]


def chord(foot: np.ndarray, along: np.ndarray, half: np.ndarray) -> tuple[float, float] | None:
    """First and last s of the line foot + s along within the rectangle +-half, each (2,); None if it misses it."""
    first, last = -np.inf, np.inf
    for f, a, h in zip(foot, along, half, strict=True):
        if a == 0:
            if abs(f) > h:
                return None
            continue
        ends = sorted([(-h - f) / a, (h - f) / a])
        first, last = max(first, ends[0]), min(last, ends[1])
    return (float(first), float(last)) if first < last else None


def near_failure(atlas: Atlas, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether one of the places (n,) mm is next to one that was not solved, at any depth and pressure."""
    failed = np.argwhere(~atlas.valid.all(axis=(2, 3)))
    # A spline leans on the solved corners of its cell.
    cell = atlas.x_mm[1] - atlas.x_mm[0], atlas.y_mm[1] - atlas.y_mm[0]
    return any(
        ((np.abs(x - atlas.x_mm[i]) <= cell[0]) & (np.abs(y - atlas.y_mm[j]) <= cell[1])).any()
        for i, j in failed
    )

"""Labelled slides as the calibration reads them: short stretches of a known line, with their mean output.

And the output at rest over all of them, with how it scatters from slide to slide.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.stream.conditioning import ONSETS, Conditioning, block_means, without_lag
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.recordings.derived_labels import UNTIMED
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import HEIGHT
from softslide.pipeline.recordings.pooled import WEIGHT
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.recordings.stroke import stage_motion

STRETCH_MM = 0.5  # a fifth of the splines' spacing: along a stretch the response is straight
LEAST_REST_BLOCKS = 5  # fewer give neither the static output nor its noise
# What contact depths, or heights of the skin, differ by at least; a gain of 1 to 2 % is worth as much.
LEAST_APART_MM = 0.1
LEAD_S = 0.1  # the contact is looked at from this long before the stage starts
# Of each static output by itself: one step of the article's converter.
LEAST_STATIC_SD_V = 5e-4
LEAST_RECORDINGS = 12  # twice the outputs of two accelerometers; fewer give no covariance
# Without these labels a slide cannot be placed on the skin.
LABELS = (
    "direction_deg",
    "speed_mm_s",
    "start_x_mm",
    "start_y_mm",
    "travel_mm",
    "motion_start_s",
    "motion_end_s",
)


@dataclass(frozen=True)
class CalibrationSlide:
    """One labelled slide, cut into m stretches of its line.

    start_mm: where it starts. travelled_mm: (m,) along the line from the start. speed_mm_s: (m,).
    volts: (m, C) V, subtracted, C channels that answer to a touch, a0_vx, a0_vy, a1_vx, ...
    blocks: how many blocks a stretch averages; step_s: the same as a time.
    rest_noise_v: (C,) V, standard deviation of one block's mean at rest.
    height_mm: of the skin; NaN: that of all slides. weight: how much it counts in a fit.
    timed: the labels say where the contact was when; else the place along the line is a first guess.
    """

    recording: str
    start_mm: tuple[float, float]
    direction_rad: float
    depth_mm: float
    travelled_mm: np.ndarray
    speed_mm_s: np.ndarray
    volts: np.ndarray
    blocks: int
    step_s: float
    rest_noise_v: np.ndarray
    timed: bool = True
    height_mm: float = math.nan
    weight: float = 1.0

    @property
    def line_offset_mm(self) -> float:
        """Signed distance of the line from the chamber's centre; differs between lines of one direction."""
        return float(signed_offset(self.direction_rad, *self.start_mm))

    def place(self, shift_mm: float, lag_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Contact positions x, y (m,) mm that the output shows, given the slide's shift and the skin's lag."""
        s = self.travelled_mm - shift_mm - lag_s * self.speed_mm_s
        return (
            self.start_mm[0] + s * np.cos(self.direction_rad),
            self.start_mm[1] + s * np.sin(self.direction_rad),
        )

    def shown(self, response: ResponseMap, shift_mm: float) -> np.ndarray:
        """Output (m, C) V along the slide by a map at its depth and height."""
        return response.response(*self.place(shift_mm, response.lag_s), self.direction_rad)


def calibration_slides(folder: Folder, conditioning: Conditioning) -> list[CalibrationSlide]:
    """The folder's fully labelled slides; those that lack a label of LABELS or a rest before them are left out."""
    rows = folder.manifest.dropna(subset=list(LABELS)).iterrows()
    slides = (_slide(folder, str(name), row, conditioning) for name, row in rows)
    return [slide for slide in slides if slide is not None]


def _slide(folder: Folder, name: str, row: Any, conditioning: Conditioning) -> CalibrationSlide | None:
    """One recording, labelled by `row` of the manifest; None if its rest is too short."""
    time_s, blocks = touch_blocks(folder, name, conditioning)
    rest = blocks[time_s < row.motion_start_s - conditioning.block_s]
    if len(rest) < LEAST_REST_BLOCKS:
        return None
    # A block in which the contact comes down or is lifted shows a part of it.
    lead_s, tail_s = (LEAD_S, 0.0) if conditioning.onset == ONSETS[0] else [-conditioning.block_s / 2] * 2
    moving = (time_s > row.motion_start_s - lead_s) & (time_s < row.motion_end_s + tail_s)
    duration_s = row.motion_end_s - row.motion_start_s
    travelled, speed = stage_motion(
        time_s[moving] - row.motion_start_s, row.travel_mm, row.speed_mm_s, duration_s
    )
    volts = without_lag(blocks, conditioning)[moving] - rest.mean(axis=0)
    count = stretch_blocks(row.speed_mm_s, conditioning.block_s)
    return CalibrationSlide(
        recording=name,
        start_mm=(float(row.start_x_mm), float(row.start_y_mm)),
        direction_rad=float(np.deg2rad(row.direction_deg)),
        depth_mm=float(row.depth_mm),
        travelled_mm=means(travelled, count),
        speed_mm_s=means(speed, count),
        volts=means(volts, count),
        blocks=count,
        step_s=count * conditioning.block_s,
        # Differences of neighbours: a slow drift of the zero is no noise.
        rest_noise_v=np.diff(rest, axis=0).std(axis=0) / np.sqrt(2),
        timed=not row.get(UNTIMED, False),
        height_mm=float(row.get(HEIGHT, math.nan)),
        weight=float(row.get(WEIGHT, 1.0)),
    )


def touch_blocks(folder: Folder, name: str, conditioning: Conditioning) -> tuple[np.ndarray, np.ndarray]:
    """Blocks of one recording: the middle of each (n,) s, and its means (n, C) V in channels that answer to a touch."""
    recording, sensor = folder.load(name), folder.sensor
    touch = touch_channels(len(sensor.channels), sensor.touch_axes)
    blocks = block_means(recording.volts, conditioning, sensor.sample_rate_hz)[:, touch]
    return recording.time_s[0] + (np.arange(len(blocks)) + 0.5) * conditioning.block_s, blocks


def several(slides: list[CalibrationSlide], covariate: str) -> bool:
    """Whether the slides' contact depths ("depth") or heights of the skin ("height") differ by LEAST_APART_MM."""
    return bool(slides) and bool(np.ptp([getattr(s, f"{covariate}_mm") for s in slides]) > LEAST_APART_MM)


def at_height(slides: list[CalibrationSlide], height_mm: float) -> np.ndarray:
    """(n,) bool: the slides of a height of the skin, mm."""
    return np.abs([slide.height_mm - height_mm for slide in slides]) <= LEAST_APART_MM


def main_height_mm(slides: list[CalibrationSlide]) -> float:
    """The height that most slides have, mm: the median of those alike. A laser reads each a little differently."""
    heights = np.array([slide.height_mm for slide in slides])
    alike = np.abs(heights[:, None] - heights) <= LEAST_APART_MM
    return float(np.median(heights[alike[alike.sum(axis=1).argmax()]]))


def stretch_blocks(speed_mm_s: float, block_s: float) -> int:
    """How many blocks a stretch of STRETCH_MM averages."""
    return max(1, round(STRETCH_MM / speed_mm_s / block_s))


def means(values: np.ndarray, count: int) -> np.ndarray:
    """Means over each `count` of the first axis; what does not fill a last one is dropped."""
    whole = len(values) // count * count
    return values[:whole].reshape(-1, count, *values.shape[1:]).mean(axis=1)


class StaticScatter(NamedTuple):
    """mean_v: (3 A,) V, all three outputs of each accelerometer; covariance_v2: (3 A, 3 A) V^2; v_per_mm: (3 A,), the
    change with the skin's height, 0 where recordings have one."""

    mean_v: np.ndarray
    covariance_v2: np.ndarray
    v_per_mm: np.ndarray


def static_scatter(
    folder: Folder, conditioning: Conditioning, height_mm: float | None = None
) -> StaticScatter | None:
    """Of the folder's recordings, before their motion; None where they are too few.

    height_mm: of recordings at several heights of the skin: the static output at this one, and its scatter about a
    line over the height. None: they have one.
    """
    statics = static_outputs(folder, conditioning)
    if len(statics) < LEAST_RECORDINGS:
        return None
    design = np.ones((len(statics), 1))
    if height_mm is not None:
        off_mm = folder.manifest.loc[list(statics), HEIGHT].to_numpy(float) - height_mm
        design = np.column_stack([design, off_mm])
    return scatter_about(design, np.array(list(statics.values())))


def static_outputs(folder: Folder, conditioning: Conditioning) -> dict[str, np.ndarray]:
    """(3 A,) V before the motion, by name, of the recordings that rest for long enough before a known start."""
    statics = {}
    for name, start_s in folder.manifest["motion_start_s"].dropna().items():
        recording = folder.load(str(name))
        rest = recording.volts[recording.time_s < start_s - conditioning.block_s]
        blocks = block_means(rest, conditioning, folder.sensor.sample_rate_hz)
        if len(blocks) >= LEAST_REST_BLOCKS:
            statics[str(name)] = blocks.mean(axis=0)
    return statics


def scatter_about(design: np.ndarray, statics: np.ndarray) -> StaticScatter:
    """Of statics (n, 3 A) V about their least-squares fit by a design (n, p): 1, and the height's offset in mm."""
    line = np.linalg.lstsq(design, statics, rcond=None)[0]
    left = statics - design @ line
    covariance = left.T @ left / (len(left) - design.shape[1])
    # Each output's own: where a tilt makes all scatter alike, their differences hardly do.
    return StaticScatter(
        line[0],
        covariance + LEAST_STATIC_SD_V**2 * np.eye(len(covariance)),
        line[1] if len(line) > 1 else np.zeros(len(covariance)),
    )

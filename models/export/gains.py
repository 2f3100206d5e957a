"""Gains of a sensor's channels on another day, from a few labelled strokes or presses and the map of an earlier day.

Each channel's gain is fitted by linear least squares with a Gaussian prior: a part that all channels share, and a
smaller one of each. A stroke's own shift along its line is fitted in turn with them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.slide_fit import CalibrationConfig, fit_slide
from softslide.models.response_map.slides import (
    LEAST_REST_BLOCKS,
    CalibrationSlide,
    calibration_slides,
    touch_blocks,
)
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import HEIGHT

# Standard deviations of the prior: a real skin was 11 to 18 % stronger on another day, channel by channel.
COMMON_SD, CHANNEL_SD = 0.15, 0.05
GAIN_ROUNDS = 3  # of gains and shifts in turn
# Stretches of which the map's residuals say as much as one: they are alike over the splines' spacing.
ALIKE = 4.0
# What a press must have labelled.
PRESS_LABELS = ("start_x_mm", "start_y_mm", "motion_start_s", "motion_end_s")


@dataclass(frozen=True)
class Press:
    """A contact that stood still. place_mm: x, y; depth_mm: NaN if unknown; volts: (C,) V, subtracted; height_mm: of
    the skin, NaN if not known."""

    place_mm: tuple[float, float]
    depth_mm: float
    volts: np.ndarray
    height_mm: float = math.nan


@dataclass(frozen=True)
class Gains:
    """gain, sd: (C,) of each channel that answers to a touch, over the map's, and its standard deviation.
    residual_v, before_v: rms of what the map leaves of the recordings with these gains and without."""

    gain: np.ndarray
    sd: np.ndarray
    residual_v: float
    before_v: float


def fit_gains(response: ResponseMap, slides: list[CalibrationSlide], presses: list[Press]) -> Gains:
    """The gains that slides and presses show. One of them at least."""
    channels = response.channels
    prior = COMMON_SD**2 * np.ones((channels, channels)) + CHANNEL_SD**2 * np.eye(channels)
    gain, noise_v, left_v = np.ones(channels), max(response.floor_v, 1e-6), list[float]()
    for _ in range(GAIN_ROUNDS):
        shown, volts, weight = _evidence(response, gain, slides, presses)
        left_v.append(_rms(volts - gain * shown))
        information = (weight[:, None] * shown**2).sum(axis=0) / noise_v**2
        covariance = np.linalg.inv(np.linalg.inv(prior) + np.diag(information))
        gain = 1.0 + covariance @ ((weight[:, None] * shown * (volts - shown)).sum(axis=0) / noise_v**2)
    # Contacts of one day scatter, each alike in all channels. A map without a rim holds the days' scatter besides.
    scatter = response.gain_sd**2 / (len(slides) + len(presses)) if response.rim else 0.0
    return Gains(gain, np.sqrt(np.diag(covariance) + scatter), _rms(volts - gain * shown), left_v[0])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _evidence(
    response: ResponseMap, gain: np.ndarray, slides: list[CalibrationSlide], presses: list[Press]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the map shows (n, C) V at the places of the recordings, their outputs (n, C) V, and the weights (n,).

    gain: with which each slide's shift is fitted.
    """
    scaled, config = response.scaled(gain), CalibrationConfig()
    parts = []
    for slide in slides:
        own = response.at(slide.depth_mm, slide.height_mm)
        shown = slide.shown(own, fit_slide(slide, scaled, config).shift_mm)
        parts.append((shown, slide.volts, np.full(len(slide.volts), 1.0 / ALIKE)))
    for press in presses:
        own = response.at(press.depth_mm, press.height_mm)
        x, y = (np.array([place]) for place in press.place_mm)
        # Opposite directions: what a contact that stands shows has no friction.
        shown = (own.response(x, y, 0.0) + own.response(x, y, np.pi)) / 2
        parts.append((shown, press.volts[None], np.ones(1)))
    shown, volts, weight = (np.concatenate(column) for column in zip(*parts, strict=True))
    return shown, volts, weight


def labelled_contacts(
    folder: Folder, conditioning: Conditioning, heights_mm: Mapping[str, float]
) -> tuple[list[CalibrationSlide], list[Press], list[str]]:
    """The folder's labelled strokes and presses, and the names of the recordings that are neither.

    heights_mm: of the skin, by recording, where several are known.
    """
    table = folder.manifest.assign(**{HEIGHT: pd.Series(heights_mm, dtype=float)})
    standing = table[list(PRESS_LABELS)].notna().all(axis=1) & _stands(table)
    slides = calibration_slides(replace(folder, manifest=table[~standing]), conditioning)
    presses = {
        str(name): press
        for name, row in table[standing].iterrows()
        if (press := _press(folder, str(name), row, conditioning)) is not None
    }
    used = {slide.recording for slide in slides} | set(presses)
    return slides, list(presses.values()), [str(n) for n in folder.manifest.index if str(n) not in used]


def _stands(manifest: pd.DataFrame) -> pd.Series:
    """Whether a contact goes nowhere: its speed is 0, or it has neither speed nor direction nor travel. A contact along
    any path may have a travel alone."""
    speed, travel = manifest["speed_mm_s"], manifest["travel_mm"]
    return (speed == 0) | (speed.isna() & manifest["direction_deg"].isna() & ~(travel > 0))


def _press(folder: Folder, name: str, row: Any, conditioning: Conditioning) -> Press | None:
    """The press of one recording, labelled by `row`; None if its rest or the press itself is too short."""
    middle_s, blocks = touch_blocks(folder, name, conditioning)
    half_s = conditioning.block_s / 2
    rest = blocks[middle_s < row.motion_start_s - half_s]
    pressed = blocks[(middle_s > row.motion_start_s + half_s) & (middle_s < row.motion_end_s - half_s)]
    if len(rest) < LEAST_REST_BLOCKS or not len(pressed):
        return None
    place, static_v = (float(row.start_x_mm), float(row.start_y_mm)), rest.mean(axis=0)
    return Press(place, float(row.depth_mm), pressed.mean(axis=0) - static_v, float(row[HEIGHT]))

"""A calibrated response map with noise, its tracker, and what paths over it show."""

from dataclasses import replace

import numpy as np
from bump_map import bump_map

from softslide.features.contact.hypotheses import (
    FRICTION_X,
    FRICTION_Y,
    HEADING,
    RESIDUAL,
    SPEED,
    Hypotheses,
    started,
)
from softslide.features.contact.track import ContactEvidence, Track
from softslide.features.contact.tracker import ContactTracker
from softslide.features.contact.tracking_config import TrackingConfig
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.card import contact_calibration
from softslide.models.response_map.map import ResponseMap

BLOCK_S = 0.02
FRICTION_MM = 0.35
TWO_BOARDS = ((-8.0, 0.0), (8.0, 0.0))
# V/mm, as of a skin that rises: boards on either side of its middle lean outwards.
INFLATION = (-0.024, 0.0, 0.024, 0.0)

CLEAR = Track(
    mean=np.array([5.0, 5.0, 3.0, 0.0]),
    covariance=1e-4 * np.eye(4),
    certain=1.0,
    misfit=1.0,
    partial=0.0,
    gain=1.0,
    depth_mm=0.0,
    depth_sd_mm=0.1,
    hypotheses=1,
    way_mm=20.0,
    evidence=ContactEvidence(10.0, 4),
)


def noisy_map(**changes) -> ResponseMap:
    response = bump_map(**changes)
    one = np.ones(response.channels)
    return replace(
        response, noise_v=1e-3 * one, zero_v=5e-4 * one, drift_v_s=0.0 * one, floor_v=5e-4, gain_sd=0.02
    )


def tracker(
    response: ResponseMap, inflation_v_per_mm: tuple[float, ...] = (), lag_blocks: int = 0
) -> ContactTracker:
    card = contact_calibration(response, inflation_v_per_mm)
    return ContactTracker(card.surface(), card, Conditioning(), TrackingConfig(), lag_blocks)


def volts_along(response: ResponseMap, path_mm: np.ndarray, seed: int = 0) -> np.ndarray:
    """Blocks (m, C) V of a contact at (m, 2) mm; friction follows the motion over FRICTION_MM of way."""
    steps = np.diff(path_mm, axis=0, prepend=path_mm[:1])
    friction, blocks = np.zeros(2), []
    for place, step in zip(path_mm, steps, strict=True):
        way = float(np.hypot(*step))
        if way:
            friction += (1 - np.exp(-way / FRICTION_MM)) * (step / way - friction)
        length = float(np.hypot(*friction))
        at = (place[:1], place[1:], float(np.arctan2(friction[1], friction[0])))
        still = (response.response(*at) + response.response(at[0], at[1], at[2] + np.pi)) / 2
        blocks.append((still + length * (response.response(*at) - still))[0])
    noise = np.random.default_rng(seed).normal(0.0, response.noise_v, (len(path_mm), response.channels))
    return np.array(blocks) + noise


def pressed(response: ResponseMap, place_mm: tuple[float, float]) -> np.ndarray:
    """(C,) V of a press: the friction of a slide is not in it."""
    x, y = np.array(place_mm[:1]), np.array(place_mm[1:])
    return (response.response(x, y, 0.0) + response.response(x, y, np.pi))[0] / 2


def touched(volts: np.ndarray) -> np.ndarray:
    """(m,): whether the last blocks (m, C) V are a touch, of 5 mV."""
    level = [np.abs(volts[max(0, n - 4) : n + 1].mean(axis=0)).max() for n in range(len(volts))]
    return np.array(level) > 0.005


def followed(response: ResponseMap, path_mm: np.ndarray, seed: int = 0) -> list[Track | None]:
    return tracks_of(response, volts_along(response, path_mm, seed))


def tracks_of(
    response: ResponseMap, volts: np.ndarray, inflation_v_per_mm: tuple[float, ...] = ()
) -> list[Track | None]:
    """The tracks of blocks (m, C) V; 5 mV are a touch."""
    tracked, every = tracker(response, inflation_v_per_mm), np.ones(volts.shape[1], dtype=bool)
    return [tracked.push(v, bool(touch), every) for v, touch in zip(volts, touched(volts), strict=True)]


def line(speed_mm_s: float, y_mm: float = 6.0, half_mm: float = 29.0) -> np.ndarray:
    return in_row(np.arange(-half_mm, half_mm, speed_mm_s * BLOCK_S), y_mm)


def in_row(x_mm: np.ndarray, y_mm: float = 6.0) -> np.ndarray:
    """(m, 2) mm: places along x."""
    return np.stack([x_mm, np.full_like(x_mm, y_mm)], axis=1)


def bank_of(response: ResponseMap, count: int = 6) -> Hypotheses:
    generator = np.random.default_rng(0)
    size = RESIDUAL + response.channels
    state = np.zeros((count, size))
    state[:, :2] = generator.uniform(-18, 18, (count, 2))
    state[:, HEADING], state[:, SPEED] = generator.uniform(-3, 3, count), generator.uniform(1, 5, count)
    state[:, 4], state[:, 5], state[:, 6] = 0.3, 0.02, generator.uniform(0.9, 1.1, count)
    state[:, FRICTION_X], state[:, FRICTION_Y] = np.cos(state[:, HEADING]), np.sin(state[:, HEADING])
    sd = np.full((count, size), 1e-6)
    return started(state, sd, np.zeros(count), partial=False)

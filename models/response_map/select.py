"""From a design and a device's slides to its response map: from the atlas, from recordings, or from both.

Of the ways that are open, the one that predicts held-out lines best is taken: a coarse or foreign atlas must not
spoil what many recordings tell, and few recordings need the atlas, and need to keep close to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from features.errors import InputError
from models.intervals import line_folds
from models.response_map.calibrate import (
    CalibrationConfig,
    CalibrationSlide,
    blank_map,
    calibrate,
    slide_residual,
)
from models.response_map.from_atlas import DeviceSpread, device_map
from models.response_map.map import ResponseMap
from pipeline.atlas.atlas import Atlas
from pipeline.sensor import Sensor

FOLDS = 4
LEAST_ALONE = 24  # slides; fewer leave the map without an atlas full of holes
# Times the penalties on what moves the map away from its prior; first: where in doubt.
STIFFNESS = (30.0, 5.0, 1.0)

Fit = Callable[[list[CalibrationSlide], ResponseMap | None], tuple[ResponseMap, dict[str, float]]]


@dataclass(frozen=True)
class DeviceMaps:
    """The device's map; and, for honest errors, maps fitted without some lines, each with those lines' recordings."""

    response: ResponseMap
    held_out: list[tuple[ResponseMap, np.ndarray]]
    summary: dict[str, float]


def device_maps(
    slides: list[CalibrationSlide],
    sensor: Sensor,
    atlas: Atlas | None,
    config: CalibrationConfig,
    spread: DeviceSpread,
) -> DeviceMaps:
    """Fits the map by every way that is open and keeps the best; `summary["from_atlas"]` says which (1 or 0).

    Raises:
        InputError: neither an atlas nor enough slides.
    """
    depth = float(np.median([s.depth_mm for s in slides])) if slides else 0.5
    if atlas is None and len(slides) < LEAST_ALONE:
        raise InputError(
            f"{sensor.name}: {len(slides)} labelled slides and no atlas; record at least {LEAST_ALONE}, "
            "or name an atlas that 'softslide simulate' made"
        )
    parts, unseen = _parts(slides)
    moved = [(None, {}) if atlas is None else device_map(atlas, sensor, p, depth, spread) for p in parts]
    priors = [prior for prior, _ in moved]
    ways = _ways(len(slides), blank_map(sensor, depth), atlas is not None, config)
    held_out = {
        name: [
            (fit(part, prior)[0], lines)
            for part, prior, lines in zip(parts[1:], priors[1:], unseen, strict=True)
        ]
        for name, fit in ways.items()
    }
    left = {name: _residual_share(slides, maps) for name, maps in held_out.items()}
    best = min(ways, key=lambda name: left[name])
    response, summary = ways[best](slides, priors[0])
    shares = {f"heldout_residual_{name}": share for name, share in left.items() if unseen}
    return DeviceMaps(
        response, held_out[best], moved[0][1] | summary | shares | {"from_atlas": float(best != "alone")}
    )


def _parts(slides: list[CalibrationSlide]) -> tuple[list[list[CalibrationSlide]], list[np.ndarray]]:
    """All the slides, then all but a fold of lines each, and the recordings of these folds."""
    if len(slides) < 2 * FOLDS:
        return [slides], []
    names = np.array([s.recording for s in slides])
    fold = line_folds(
        np.array([s.direction_rad for s in slides]), np.array([s.offset_key for s in slides]), FOLDS
    )
    numbers = np.unique(fold)
    parts = [[s for s, f in zip(slides, fold, strict=True) if f != number] for number in numbers]
    return [slides, *parts], [names[fold == number] for number in numbers]


def _ways(slides: int, blank: ResponseMap, has_atlas: bool, config: CalibrationConfig) -> dict[str, Fit]:
    """The fits that are open: near an atlas's prior, each with its stiffness, and from recordings alone."""

    def near(stiffness: float) -> Fit:
        stiff = config.stiffened(stiffness)

        def fit(part: list[CalibrationSlide], prior: ResponseMap | None):
            assert prior is not None
            return calibrate(part, prior, True, stiff) if part else (prior, {})

        return fit

    def alone(part: list[CalibrationSlide], prior: ResponseMap | None):
        # Recordings of one depth say nothing of others: that part is the design's in any case.
        start = blank if prior is None else replace(blank, depth_slope=prior.depth_slope)
        return calibrate(part, start, False, config)

    ways: dict[str, Fit] = {f"atlas_{s:g}": near(s) for s in STIFFNESS} if has_atlas else {}
    return ways | ({"alone": alone} if slides >= LEAST_ALONE else {})


def _residual_share(slides: list[CalibrationSlide], maps: list[tuple[ResponseMap, np.ndarray]]) -> float:
    """Median over slides of what their held-out map leaves over, as a share of the slide's largest output."""
    shares = [
        slide_residual(slide, response) / np.abs(slide.volts).max()
        for response, unseen in maps
        for slide in slides
        if slide.recording in unseen
    ]
    return float(np.median(shares)) if shares else 0.0

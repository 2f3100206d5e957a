"""From a design and a device's slides to its response map: from the atlas, from recordings, or from both.

Where both ways are open, the one that predicts held-out lines better is taken: a coarse or foreign atlas must not
spoil what many recordings tell, and few recordings need the atlas.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from features.errors import InputError
from models.calibration import CalibrationConfig, CalibrationSlide, blank_map, calibrate, slide_residual
from models.intervals import line_folds
from models.prior import DeviceSpread, device_map
from models.response_map import ResponseMap
from pipeline.atlas import Atlas
from pipeline.sensor import Sensor

FOLDS = 4
LEAST_ALONE = 24  # slides; fewer leave the map without an atlas full of holes

Fit = Callable[[list[CalibrationSlide], int], tuple[ResponseMap, dict[str, float]]]


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

    blank = blank_map(sensor, depth)
    if atlas is not None and slides:
        # Recordings of one depth say nothing of others: that part is the design's in any case.
        blank = replace(blank, depth_slope=device_map(atlas, sensor, slides, depth, spread)[0].depth_slope)

    def alone(part: list[CalibrationSlide], iterations: int) -> tuple[ResponseMap, dict[str, float]]:
        return calibrate(part, blank, False, replace(config, iterations=iterations))

    def informed(part: list[CalibrationSlide], iterations: int) -> tuple[ResponseMap, dict[str, float]]:
        assert atlas is not None
        prior, moved = device_map(atlas, sensor, part, depth, spread)
        if not part:
            return prior, moved
        response, report = calibrate(part, prior, True, replace(config, iterations=iterations))
        return response, moved | report

    ways: dict[bool, Fit] = {}
    if atlas is not None:
        ways[True] = informed
    if len(slides) >= LEAST_ALONE:
        ways[False] = alone
    if not ways:
        raise InputError(
            f"{sensor.name}: {len(slides)} labelled slides and no atlas; record at least {LEAST_ALONE}, "
            "or name an atlas that 'softslide simulate' made"
        )
    held = {way: _held_out(slides, fit) if len(slides) >= 2 * FOLDS else [] for way, fit in ways.items()}
    left = {way: _residual_share(slides, maps) for way, maps in held.items()}
    best = min(ways, key=lambda way: left[way])
    response, summary = ways[best](slides, config.iterations)
    shares = {
        f"heldout_residual_{'atlas' if way else 'alone'}": share for way, share in left.items() if held[way]
    }
    return DeviceMaps(response, held[best], summary | shares | {"from_atlas": float(best)})


def _held_out(slides: list[CalibrationSlide], fit: Fit) -> list[tuple[ResponseMap, np.ndarray]]:
    """Maps without a fold of lines each, and the recordings along those lines. Fewer alternations will do."""
    names = np.array([s.recording for s in slides])
    fold = line_folds(
        np.array([s.direction_rad for s in slides]), np.array([s.offset_key for s in slides]), FOLDS
    )
    parts = [[s for s, f in zip(slides, fold, strict=True) if f != number] for number in range(FOLDS)]
    return [
        (fit(part, 2)[0], names[fold == number])
        for number, part in enumerate(parts)
        if len(part) < len(slides)
    ]


def _residual_share(slides: list[CalibrationSlide], maps: list[tuple[ResponseMap, np.ndarray]]) -> float:
    """Median over slides of what their held-out map leaves over, as a share of the slide's largest output."""
    shares = [
        slide_residual(slide, response) / np.abs(slide.volts).max()
        for response, unseen in maps
        for slide in slides
        if slide.recording in unseen
    ]
    return float(np.median(shares)) if shares else 0.0

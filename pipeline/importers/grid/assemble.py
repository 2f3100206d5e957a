"""Slides over a grid of presses: each sample is the press of one pass that is nearest to where the contact is.

Nothing is interpolated, and nothing averaged. A slide begins with a touch-down and ends with a lift. Its output is the
reading at rest of its first press, and on top of it what the presses changed; before and after the motion, what two
readings at rest differ by.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.grid.grid_map import GridMap, GridSplit
from softslide.pipeline.importers.grid.lattice import GridPath, curve, lines
from softslide.pipeline.importers.grid.presses import Presses, read_presses
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.recordings.truth import COLUMNS


@dataclass(frozen=True)
class _Slide:
    """One slide to assemble: from the pass of that index, at a constant speed."""

    name: str
    split: GridSplit
    number: int
    path: GridPath
    speed_mm_s: float


def import_grid(source: Path, mapping: GridMap, out: Path) -> tuple[Folder, list[str]]:
    """Writes the folder; returns it and what is worth telling.

    Raises:
        InputError: the presses or the map are bad, or no slide could be made; nothing is left then.
    """
    presses = read_presses(source, mapping)
    sensor = replace(mapping.sensor, origin="assembled")
    slides, notes = _slides(presses, mapping, source)
    recordings, rows = [], []
    for slide in progress_bar("assembling", "slide", slides, len(slides)):
        recording, row = _assembled(slide, presses, mapping)
        recordings.append(recording)
        rows.append(row)
    origin = {
        "what": "slides assembled from presses on a grid: each sample is a press as measured, the motion is made",
        "source": source.name,
        "notes": notes,
    }
    folder = write_folder(
        out, sensor, pd.DataFrame(rows), recordings, {"import.json": json.dumps(origin, indent=1) + "\n"}
    )
    return folder, notes


def _slides(presses: Presses, mapping: GridMap, source: Path) -> tuple[list[_Slide], list[str]]:
    """The slides of every split, and a note for those that lack a press."""
    slides: list[_Slide] = []
    notes = []
    low, high = np.log(mapping.speed_mm_s)
    for k, split in enumerate(mapping.splits):
        if unknown := [n for n in split.passes if n not in presses.passes]:
            known = ", ".join(map(str, presses.passes.tolist()))
            raise InputError(f"{source}: no pass {unknown[0]} (it has {known}); correct split '{split.name}'")
        draw = np.random.default_rng([mapping.seed, k])
        numbers = [int(np.flatnonzero(presses.passes == n)[0]) for n in split.passes]
        complete, lacking = [], 0
        for n, path in enumerate(_paths(presses, split, draw)):
            number = numbers[n % len(numbers)]
            speed = float(np.exp(draw.uniform(low, high)))
            slide = _Slide(f"{split.name}-{n:04d}", split, number, path, speed)
            if np.isfinite(presses.change[(number, *_places(slide, presses, mapping)[1].T)]).all():
                complete.append(slide)
            else:
                lacking += 1
        if lacking:
            notes.append(
                f"{split.name}: left out {lacking} of {lacking + len(complete)} slides that lack a press"
            )
        slides += complete
    if not slides:
        raise InputError(f"{source}: no slide has all its presses; correct the splits of {mapping.path.name}")
    return slides, notes


def _paths(presses: Presses, split: GridSplit, draw: np.random.Generator) -> Iterator[GridPath]:
    if split.paths != "lines":
        for _ in range(split.count):
            yield curve(split.paths, presses.x_mm, presses.y_mm, draw)
        return
    every = lines(presses.x_mm, presses.y_mm, split.colour)
    # In mixed order, so that directions and passes have nothing to do with each other.
    for n in draw.permutation(len(every))[: split.count or None]:
        yield every[n]


def _places(slide: _Slide, presses: Presses, mapping: GridMap) -> tuple[np.ndarray, np.ndarray]:
    """How far along (n,) mm each sample of the motion is, and its nearest place of the split's colour (n, 2)."""
    count = int(slide.path.length_mm / slide.speed_mm_s * mapping.sensor.sample_rate_hz)
    way = np.arange(count) * slide.speed_mm_s / mapping.sensor.sample_rate_hz
    u = (slide.path.at(way)[0] - (presses.x_mm[0], presses.y_mm[0])) / presses.step_mm
    size = np.array([len(presses.x_mm), len(presses.y_mm)])
    nearest = np.clip(np.round(u).astype(int), 0, size - 1)
    if slide.split.colour == "any":
        return way, nearest
    # The nearest place of one colour is the nearest of all or one of its four neighbours.
    around = nearest[:, None] + np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    allowed = (around.sum(axis=2) % 2 == (slide.split.colour == "odd")) & (
        (around >= 0) & (around < size)
    ).all(axis=2)
    distance = np.where(allowed, np.hypot(*(around - u[:, None]).transpose(2, 0, 1)), np.inf)
    return way, around[np.arange(count), distance.argmin(axis=1)]


def _assembled(slide: _Slide, presses: Presses, mapping: GridMap) -> tuple[Recording, dict[str, object]]:
    rate = mapping.sensor.sample_rate_hz
    way, place = _places(slide, presses, mapping)
    at = (slide.number, *place.T)
    before = round(mapping.rest_s * rate)
    count = before + len(way) + before // 2
    # A stretch of the pass's own idle readings, another for each slide.
    idle = presses.idle[slide.number]
    shown = idle[(own_number(slide.name) + np.arange(count)) % len(idle)]
    shown[before : before + len(way)] = presses.change[at]
    time_s = np.arange(count) / rate
    start, end = time_s[before], time_s[before + len(way) - 1]
    depth = presses.depth_mm[at]
    row: dict[str, object] = {
        "recording": slide.name,
        "split": slide.split.name,
        "depth_mm": round(float(np.median(depth)), 3),
        "motion_start_s": start,
        "motion_end_s": end,
        "pass": int(presses.passes[slide.number]),
    }
    truth = None
    if slide.split.paths == "lines":
        row |= _line_labels(slide, mapping, float(way[-1]))
    else:
        truth = _truth(slide, time_s, before, way, depth)
    return Recording(slide.name, time_s, presses.rest[at][0] + shown, truth), row


def own_number(name: str) -> int:
    """A number that is the slide's own."""
    return sum(31**n * byte for n, byte in enumerate(name.encode()[::-1])) % 1_000_003


def _line_labels(slide: _Slide, mapping: GridMap, travel_mm: float) -> dict[str, object]:
    (x, y), ahead = slide.path.corners[0], np.diff(slide.path.corners, axis=0)[0]
    angle = np.arctan2(ahead[1], ahead[0])
    reference = mapping.sensor.reference_mm
    return {
        "direction_deg": round(float(np.degrees(angle)) % 360.0, 6),
        "speed_mm_s": slide.speed_mm_s,
        "offset_mm": float(signed_offset(angle, x - reference[0], y - reference[1])) + 0.0,
        "start_x_mm": float(x),
        "start_y_mm": float(y),
        "travel_mm": travel_mm,
    }


def _truth(
    slide: _Slide, time_s: np.ndarray, before: int, way: np.ndarray, depth: np.ndarray
) -> pd.DataFrame:
    """Where the contact is at each sample; before and after the motion, where it comes down and goes up."""
    moving = slice(before, before + len(way))
    along = np.pad(way, (before, len(time_s) - before - len(way)), mode="edge")
    place, ahead = slide.path.at(along)
    contact = np.zeros(len(time_s))
    contact[moving] = 1
    deep = np.full(len(time_s), np.nan)
    deep[moving] = depth
    velocity = slide.speed_mm_s * ahead * contact[:, None]
    columns = (time_s, *place.T, *velocity.T, contact, deep)
    return pd.DataFrame(dict(zip(COLUMNS, columns, strict=True)))

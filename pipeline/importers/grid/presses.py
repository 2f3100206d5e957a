"""Presses on a grid, read from one delimited file: a row a press."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.importers.grid.grid_map import GridMap
from softslide.pipeline.recordings.text_table import numbers, read_text_table

# Places of one grid line may differ by this share of the grid's step: a robot's own readings.
SAME_PLACE = 0.1


@dataclass(frozen=True)
class Presses:
    """P passes over an even grid of X x Y places; NaN where a pass has no press.

    x_mm: (X,); y_mm: (Y,). change: (P, X, Y, C), in the sensor's unit, between rest and press. rest: likewise, the
    reading at rest that was subtracted. depth_mm: (P, X, Y). passes: (P,) their numbers. idle: for each pass (n, C),
    the change from one reading at rest to the next one's: the noise of a change where nothing touches.
    """

    x_mm: np.ndarray
    y_mm: np.ndarray
    change: np.ndarray
    rest: np.ndarray
    depth_mm: np.ndarray
    passes: np.ndarray
    idle: tuple[np.ndarray, ...]

    @property
    def step_mm(self) -> float:
        """Between neighbouring places."""
        return float(self.x_mm[1] - self.x_mm[0])


def read_presses(path: Path, mapping: GridMap) -> Presses:
    """Reads a file of presses.

    Raises:
        InputError: no table, a column or a number is missing, the places are not an even grid, or a place comes twice
            in a pass.
    """
    channels = [mapping.channels[name] for name in mapping.sensor.channels]
    outputs = [c.column for c in channels] + [c.rest for c in channels]
    named = [mapping.x, mapping.y, *filter(None, (mapping.depth, mapping.passes)), *outputs]
    table = read_text_table(path, "name a table of presses")
    for column in named:
        if column not in table:
            raise InputError(f"{path}: column '{column}' is missing; correct its name in {mapping.path.name}")
        if (bad := ~np.isfinite(numbers(table[column]))).any():
            raise InputError(
                f"{path}: row {bad.argmax() + 1}, column {column} is not a finite number; correct it"
            )
    x_mm, x = _axis(path, mapping.x, table[mapping.x].to_numpy(float))
    y_mm, y = _axis(path, mapping.y, table[mapping.y].to_numpy(float))
    if abs((x_mm[1] - x_mm[0]) / (y_mm[1] - y_mm[0]) - 1) > SAME_PLACE:
        raise InputError(
            f"{path}: steps along {mapping.x} and {mapping.y} differ; only a square grid is read"
        )
    number = table[mapping.passes].to_numpy() if mapping.passes else np.zeros(len(table), dtype=int)
    passes, p = np.unique(number, return_inverse=True)
    if (twice := pd.MultiIndex.from_arrays([p, x, y]).duplicated()).any():
        row = int(twice.argmax())
        raise InputError(
            f"{path}: row {row + 1}: its place comes twice in pass {number[row]}; name the passes"
        )
    depth = table[mapping.depth].to_numpy(float) if mapping.depth else np.full(len(table), np.nan)
    if mapping.depth and mapping.surface_mm is not None:
        depth = mapping.surface_mm - depth
    readings = table[outputs].to_numpy(float)
    grid = np.full((len(passes), len(x_mm), len(y_mm), len(outputs) + 1), np.nan)
    grid[p, x, y] = np.column_stack([readings, depth])
    change, rest, deep = np.split(grid, [len(channels), len(outputs)], axis=-1)
    idle = tuple(_idle(x[p == n], y[p == n], readings[p == n, len(channels) :]) for n in range(len(passes)))
    return Presses(x_mm, y_mm, change, rest, deep[..., 0], passes, idle)


def _axis(path: Path, column: str, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The grid's places along one axis (n,) mm, and which of them each row is at."""
    distinct = np.unique(values)
    gaps = np.diff(distinct)
    if not len(gaps):
        raise InputError(f"{path}: column {column} holds one place alone; a grid has several")
    step = float(np.median(gaps[gaps > 0.5 * gaps.max()]))
    number = np.round((values - distinct[0]) / step).astype(int)
    places = distinct[0] + step * np.arange(number.max() + 1)
    if (off := np.abs(values - places[number])).max() > SAME_PLACE * step:
        raise InputError(
            f"{path}: row {off.argmax() + 1}, {column} = {values[off.argmax()]:g} is {off.max():.2g} mm off the grid "
            f"of {step:g} mm; only an even grid is read"
        )
    return places, number


def _idle(x: np.ndarray, y: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Changes of the reading at rest from each press to the next one, where that is its neighbour."""
    neighbours = np.abs(np.diff(x)) + np.abs(np.diff(y)) == 1
    return np.diff(rest, axis=0)[neighbours]

"""`softslide design`: where to put the accelerometers of a skin, and what they can reach."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.pages.figures import COLOURS, Panel, chart, on_cells, rectangle
from softslide.experiments.pages.page import panels_page
from softslide.features.errors import InputError
from softslide.models.design.board_places import (
    Arrangement,
    arrangement,
    best_places,
    information,
    lines_over,
    nearest_places,
)
from softslide.models.design.line_information import Line
from softslide.pipeline.atlas.bare_skin import solve_tilts
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.sensor import Accelerometer, Sensor, read_sensor, write_sensor
from softslide.pipeline.staging import staged

HEIGHT_MM = 7.0  # of the default sensor's three the middle one
CELL_MM = 5.0
NEAR_MM = 5.0  # a line counts for a cell within this
# Quantity of an arrangement's deviations: name, unit and factor to it.
QUANTITIES = (("direction", "deg", 180 / np.pi), ("speed", "percent", 100.0), ("distance", "mm", 1.0))
QUANTILES = (0.5, 0.95)


def design(
    sensor: str | Path,
    out: str | Path,
    boards: Sequence[int] = (1, 2, 3, 4),
    thickness_mm: float | None = None,
    height_mm: float | None = None,
    chamber_mm: Sequence[float] | None = None,
    depth_mm: float = 0.5,
) -> pd.DataFrame:
    """Writes `design.html`, `design.csv` and a `sensor-N.toml` for each number of boards; the table.

    The table has a row for the sensor's own boards, each at the nearest place looked at, and one for the best places of
    each number: bounds of direction (deg), speed (%) and distance (mm), median and 95th percentile over lines.

    Raises:
        InputError: the sensor or a size is wrong, or so many boards do not fit.
    """
    changed = _changed(read_sensor(sensor), thickness_mm, chamber_mm)
    if not changed.measures_gravity:
        raise InputError(f"{sensor}: the solved skin tilts accelerometers alone; design with one")
    if min(boards) < 1:
        raise InputError(f"{min(boards)}: place at least one", "boards")
    height = height_mm if height_mm is not None else HEIGHT_MM
    field = solve_tilts(
        changed, height, depth_mm, lambda lines, count: progress_bar("solving", "line", lines, count)
    )
    lines = lines_over(changed)
    known = information(field, changed, lines)
    own = nearest_places(field.places_mm, [(a.x_mm, a.y_mm) for a in changed.accelerometers])
    found = {"as it is": arrangement(field.places_mm[own], known[own].sum(axis=0))}
    for count in boards:
        found[f"{count} best"] = best_places(field.places_mm, known, count, changed.board.size_mm)
    table = pd.DataFrame([_row(name, each) for name, each in found.items()])
    maps = {name: _over_the_skin(each, lines, changed) for name, each in found.items()}
    every = [value for values in maps.values() for value in values.values()]
    scale = mpl.colors.LogNorm(min(every), max(every))
    groups = [
        (_title(name, each), [_map(each, maps[name], scale, changed), _distribution(each)])
        for name, each in found.items()
    ]
    with staged(Path(out)) as scratch:
        table.to_csv(scratch / "design.csv", index=False, float_format="%.4g", lineterminator="\n")
        for name, each in found.items():
            if name != "as it is":
                write_sensor(scratch / f"sensor-{len(each.places_mm)}.toml", _with_boards(changed, each))
        text = panels_page(
            f"Where to put the accelerometers of {changed.name}",
            _explained(changed, height, depth_mm),
            groups,
        )
        (scratch / "design.html").write_text(text, encoding="utf-8")
    return table


def _changed(sensor: Sensor, thickness_mm: float | None, chamber_mm: Sequence[float] | None) -> Sensor:
    try:
        return replace(
            sensor,
            skin_thickness_mm=sensor.skin_thickness_mm if thickness_mm is None else thickness_mm,
            chamber_mm=sensor.chamber_mm if chamber_mm is None else (chamber_mm[0], chamber_mm[1]),
        )
    except ValueError as error:
        raise InputError(str(error)) from None


def _with_boards(sensor: Sensor, found: Arrangement) -> Sensor:
    """The sensor with boards like its first at the places; the reference point is their middle."""
    first = sensor.accelerometers[0]
    parts: tuple[Accelerometer, ...] = tuple(
        replace(first, name=f"a{n}", x_mm=float(x), y_mm=float(y)) for n, (x, y) in enumerate(found.places_mm)
    )
    middle = found.places_mm.mean(axis=0)
    return replace(sensor, accelerometers=parts, reference_mm=(float(middle[0]), float(middle[1])))


def _row(name: str, found: Arrangement) -> dict[str, Any]:
    row: dict[str, Any] = {"boards": name, "places_mm": "; ".join(f"{x:g} {y:g}" for x, y in found.places_mm)}
    for (quantity, unit, factor), deviations in zip(QUANTITIES, found.deviations, strict=True):
        median, high = factor * np.quantile(deviations, QUANTILES)
        row |= {f"{quantity}_median_{unit}": median, f"{quantity}_p95_{unit}": high}
    return row


def _title(name: str, found: Arrangement) -> str:
    words = "Boards as they are" if name == "as it is" else f"Best places of {len(found.places_mm)}"
    return f"{words}: {', '.join(f'({x:g}, {y:g})' for x, y in found.places_mm)} mm"


def _explained(sensor: Sensor, height_mm: float, depth_mm: float) -> list[str]:
    return [
        f"Chamber {sensor.chamber_mm[0]:g} x {sensor.chamber_mm[1]:g} mm, skin {sensor.skin_thickness_mm:g} mm thick, "
        f"inflated to {height_mm:g} mm, contact {depth_mm:g} mm deep. The bare skin is solved; boards are taken to "
        "tilt with it and not to disturb each other.",
        "Each figure is the Cramer-Rao bound: the least standard deviation that any unbiased estimate can have once a "
        "slide of 2 mm/s has crossed the chamber, with the noise and the residual of a calibrated sensor. A real "
        "sensor has more.",
    ]


def _over_the_skin(found: Arrangement, lines: list[Line], sensor: Sensor) -> dict[tuple[float, float], float]:
    """By the middle of each cell, mm: the median bound of the distance, mm, of lines that pass near it, if any."""
    xs, ys = (np.arange(-size / 2 + CELL_MM / 2, size / 2, CELL_MM) for size in sensor.chamber_mm)
    direction, offset_mm = np.array([(line.direction_rad, line.offset_mm) for line in lines]).T
    normal = np.column_stack([-np.sin(direction), np.cos(direction)])
    near = {(x, y): np.abs(normal @ np.array([x, y]) - offset_mm) < NEAR_MM for y in ys for x in xs}
    return {place: float(np.median(found.deviations[2, some])) for place, some in near.items() if some.any()}


def _map(found: Arrangement, values: dict[tuple[float, float], float], scale: Any, sensor: Sensor) -> Panel:
    """The bound of the distance over the skin, with the boards. scale: from mm to colours, the same for every map."""

    def boards(ax: Axes) -> None:
        for place in found.places_mm:
            half = np.array(sensor.board.size_mm) / 2
            rectangle(ax, place - half, place + half, fill=False, edgecolor=COLOURS[1], linewidth=2)

    places = ", ".join(f"({x:g}, {y:g})" for x, y in found.places_mm)
    text = (
        f"Attainable error of the distance (mm) of lines that pass within {NEAR_MM:g} mm of each place, medians, with "
        f"boards at {places} mm; one scale of colours for all maps."
    )
    title = "attainable error of the distance, mm"
    return on_cells(_with_boards(sensor, found), text, values, CELL_MM, "{:.2f}", title, scale, boards)


def _distribution(found: Arrangement) -> Panel:
    """What share of lines has a bound below each value."""
    count = found.deviations.shape[1]
    parts, medians = [], []
    for (quantity, unit, factor), deviations in zip(QUANTITIES, found.deviations, strict=True):
        shown = unit.replace("percent", "%")
        errors = factor * np.sort(deviations)
        share = 100 * (np.arange(count) + 1) / count
        parts.append(pd.DataFrame({"of": f"{quantity}, {shown}", "error": errors, "share": share}))
        medians.append(f"{quantity} {np.median(errors):.2g} {shown}")

    def logarithmic(ax: Axes) -> None:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter("{x:g}")

    text = f"Share of lines over the chamber whose attainable error is below each value; medians: {', '.join(medians)}."
    labels, table = ("over all lines", "attainable error, in its unit", "share of lines, %"), pd.concat(parts)
    return chart(table, "error", "share", "of", labels, text, mark="-", limit=50.0, draw=logarithmic)

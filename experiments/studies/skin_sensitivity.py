"""What each assumption about the skin moves: one of them changed at a time, a line forth and back solved anew.

The inflated height is held at one value throughout, as a laser would: then the modulus changes the pressure and the
forces, and neither tilt nor width.
"""

from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from experiments.tracking.study import tracked_study
from pipeline.atlas.atlas import DEFAULT_SENSOR
from pipeline.sensor import Sensor, read_sensor
from pipeline.skin.lines import Line
from pipeline.skin.solved_line import skin_of, solve_line
from pipeline.skin.solver import NoEquilibrium

STEP_MM = 1.25
# Of the line beside the board, as the article's X-slides at y = 10 mm; heights as the shipped atlas's middle one.
OFFSET_MM, DEPTH_MM, HEIGHT_MM = 10.0, 0.5, 7.0
# The article's base: silicone of 1.2 MPa, 64 mm wide round a chamber of 50 mm and 10 mm deep; the skin is 60 mm wide.
BASE_MPA, WALL_MM, WALL_HEIGHT_MM, OVERLAP_MM = 1.2, 7.0, 10.0, 5.0
SHEAR_CORRECTION = 5 / 6  # of a rectangular section (Timoshenko's beam)
# What is shown, with its unit.
SHOWN = {
    "extremes_mm": "V_x minimum to maximum, mm",
    "width_mm": "rms width of V_x, mm",
    "static_deg": "static tilt, deg",
    "hysteresis_mm": "forth to back, mm",
    "peak_mg": "largest V_x, mg",
    "force_mn": "largest normal force, mN",
}


class Variant(NamedTuple):
    """What is changed, its value, the sensor, the skin's height and the contact depth."""

    changed: str
    to: str
    sensor: Sensor
    height_mm: float = HEIGHT_MM
    depth_mm: float = DEPTH_MM


def variants(sensor: Sensor) -> Iterator[Variant]:
    """First the design, then one number changed at a time."""
    skin, board, mesh = sensor.skin, sensor.board, sensor.mesh
    yield Variant("design", "", sensor)
    for value in (0.0, 0.3, 0.5, 0.8):
        yield Variant("friction", f"{value:g}", replace(sensor, skin=replace(skin, friction=value)))
    for value in (5.0, 6.0, 8.5):
        yield Variant("height, mm", f"{value:g}", sensor, height_mm=value)
    for value in (0.3, 1.0):
        yield Variant("depth, mm", f"{value:g}", sensor, depth_mm=value)
    for value in (3.0, 5.0):
        yield Variant("skin, mm", f"{value:g}", replace(sensor, skin_thickness_mm=value))
    for value in (48.0, 54.0):
        yield Variant("chamber, mm", f"{value:g}", replace(sensor, chamber_mm=(value, value)))
    for value in (6.0, 8.0, 12.0):
        bond = replace(board, size_mm=(value, value))
        yield Variant("board's bond, mm", f"{value:g}", replace(sensor, board=bond))
    for value in (1.0, 2.4):
        thick = replace(board, thickness_mm=value)
        yield Variant("board's thickness, mm", f"{value:g}", replace(sensor, board=thick))
    for value in (0.035, 0.14):
        soft = replace(skin, youngs_modulus_mpa=value)
        yield Variant("Young's modulus, MPa", f"{value:g}", replace(sensor, skin=soft))
    for value in (1.0, 4.0):
        bulk = replace(skin, bulk_modulus_mpa=value)
        yield Variant("bulk modulus, MPa", f"{value:g}", replace(sensor, skin=bulk))
    for value in (2.5, 5.0):
        bonded = replace(skin, overlap_mm=value)
        yield Variant("skin on the base, mm", f"{value:g}", replace(sensor, skin=bonded))
    for share in (1.0, 0.5):
        elastic = replace(skin, overlap_mm=OVERLAP_MM, base_mpa_mm=wall_stiffness(share * BASE_MPA))
        yield Variant(
            f"{OVERLAP_MM:g} mm on a base of, MPa", f"{share * BASE_MPA:g}", replace(sensor, skin=elastic)
        )
    for value in (0.98, 1.05):
        stretched = replace(skin, prestretch=value)
        yield Variant("prestretch", f"{value:g}", replace(sensor, skin=stretched))
    for name, edge in (("across", (0.0, 10.0)), ("along", (10.0, 0.0))):
        yield Variant(f"edge of 10 mm {name}", "", replace(sensor, indenter_edge_mm=edge))
    for value in (3.0, 12.0):
        yield Variant("ball, mm", f"{value:g}", replace(sensor, indenter_diameter_mm=value))
    for size, layers in ((3.4, 1), (2.0, 1), (2.5, 2)):
        finer = replace(sensor, mesh=replace(mesh, size_mm=size, layers=layers))
        yield Variant("mesh, mm x layers", f"{size:g} x {layers}", finer)


def sensitivity(
    sensor_path: Path | None, picture: Path | None, store: str | None = None
) -> Iterator[dict[str, Any]]:
    """A row for each variant: `changed`, `to` and the figures of SHOWN, NaN where no equilibrium was found.

    A run is logged, with one below it a variant. picture: drawn at the end. store: as in
    `tracking.store.store_address`.

    Raises:
        InputError: the sensor is none.
    """
    sensor = read_sensor(sensor_path or DEFAULT_SENSOR)
    rows = []
    configuration = {"sensor": asdict(sensor)}
    name = f"sensitivity of {sensor.name}"
    with tracked_study("sensitivity", name, configuration, Path("sensitivity"), store=store) as (_, part):
        for changed, to, variant, height_mm, depth_mm in variants(sensor):
            setting, found = {"changed": changed, "to": to}, figures(variant, height_mm, depth_mm)
            part(f"{changed} {to}".strip(), setting, found)
            rows.append({**setting, **found})
            yield rows[-1]
    if picture is not None:
        draw(pd.DataFrame(rows), picture)


def wall_stiffness(modulus_mpa: float) -> tuple[float, float]:
    """Traction over displacement, normal and tangential, MPa/mm, of the chamber's wall under the skin that lies on it.

    The wall is a beam on a rigid floor, incompressible and in plane strain: it is compressed, or bends and shears.
    """
    stretched, sheared = modulus_mpa / (1 - 0.5**2), modulus_mpa / 3
    bending = WALL_HEIGHT_MM**3 / (3 * stretched * WALL_MM**3 / 12)
    shear = WALL_HEIGHT_MM / (SHEAR_CORRECTION * sheared * WALL_MM)
    return stretched * WALL_MM / WALL_HEIGHT_MM / OVERLAP_MM, 1 / (bending + shear) / OVERLAP_MM


def figures(sensor: Sensor, height_mm: float, depth_mm: float) -> dict[str, float]:
    """SHOWN of the first accelerometer, for X-slides forth and back, OFFSET_MM beside it."""
    along = np.arange(-sensor.chamber_mm[0] / 2, sensor.chamber_mm[0] / 2 + STEP_MM / 2, STEP_MM)
    try:
        pressure, inflated = skin_of(sensor).inflate_to(height_mm)
    except NoEquilibrium:
        return dict.fromkeys(SHOWN, np.nan)
    offset = sensor.accelerometers[0].y_mm + OFFSET_MM
    solved = [
        solve_line(sensor, Line(0, sense, offset), along, depth_mm, pressure, inflated)[0]
        for sense in (1, -1)
    ]
    if not np.isfinite(solved).all():
        return dict.fromkeys(SHOWN, np.nan)
    tilts_g = [each[:, 0] for each in solved]
    low, high = (np.array([extreme(along, sign * each) for each in tilts_g]) for sign in (-1, 1))
    return {
        "extremes_mm": float(np.mean(np.abs(high - low))),
        "width_mm": width(along, np.mean(tilts_g, axis=0)),
        "static_deg": float(np.degrees(np.arccos(inflated.rotations[0, 2, 2]))),
        "hysteresis_mm": float(np.mean([low[0] - low[1], high[0] - high[1]])),
        "peak_mg": 1e3 * float(np.mean([each.max() for each in tilts_g])),
        "force_mn": 1e3 * float(np.max([each[:, -1] for each in solved])),
    }


def extreme(along_mm: np.ndarray, values: np.ndarray) -> float:
    """Where evenly spaced values (n,) are largest, in mm: the top of the parabola through the three values there."""
    top = int(np.clip(values.argmax(), 1, len(values) - 2))
    left, middle, right = values[top - 1 : top + 2]
    return float(along_mm[top] + STEP_MM * 0.5 * (left - right) / (left - 2 * middle + right))


def width(along_mm: np.ndarray, values: np.ndarray) -> float:
    """Root of the second moment of values squared (n,) about their centre, in mm."""
    weight = values**2 / np.sum(values**2)
    return float(np.sqrt(weight @ (along_mm - weight @ along_mm) ** 2))


def draw(rows: pd.DataFrame, out: Path) -> None:
    """Writes a column of bars for each figure, of the kind that the name's ending says (.svg, .png, .pdf)."""
    figure, axes = plt.subplots(1, len(SHOWN), sharey=True, figsize=(15, 7), layout="constrained")
    names = (rows["changed"] + " " + rows["to"]).str.strip()
    places = np.arange(len(rows))[::-1]
    for ax, (name, title) in zip(axes, SHOWN.items(), strict=True):
        ax.barh(places, rows[name], color=["#c44" if n == "design" else "#48a" for n in names], height=0.7)
        ax.axvline(rows[name].iloc[0], color="k", lw=0.8, ls=":")
        for place, value in zip(places, rows[name], strict=True):
            text = "no equilibrium" if np.isnan(value) else f"{value:.3g}"
            ax.text(0.02, place, text, transform=ax.get_yaxis_transform(), va="center", fontsize=7)
        ax.set_title(title, fontsize=9)
        ax.tick_params(labelsize=8)
    axes[0].set_yticks(places, names)
    figure.savefig(out)
    plt.close(figure)

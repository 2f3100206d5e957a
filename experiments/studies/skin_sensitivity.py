"""What each assumption about the skin moves.

Changes one number of a design at a time and solves a line along x forth and back, 10 mm from the first accelerometer.
The inflated height is held, as a laser would hold it: then the modulus changes pressure and forces, neither tilt nor
width. Prints for each change: distance of V_x's extremes, its width and hysteresis in mm, static tilt in deg, largest
V_x in mg, largest normal force in mN. Minutes on one core.

    python -m softslide.experiments.studies.skin_sensitivity --picture sensitivity.svg
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from softslide.experiments.studies.script import Part, parser, run
from softslide.experiments.studies.skin_changes import CHANGES, changed
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.sensor import Sensor, read_sensor
from softslide.pipeline.skin.lines import Line
from softslide.pipeline.skin.solved_line import skin_of, solve_line
from softslide.pipeline.skin.solver import NoEquilibrium

STEP_MM = 1.25
OFFSET_MM = 10.0  # of the line from the board, as the article's X-slides at y = 10 mm
SHOWN = {
    "extremes_mm": "V_x minimum to maximum, mm",
    "width_mm": "rms width of V_x, mm",
    "static_deg": "static tilt, deg",
    "hysteresis_mm": "forth to back, mm",
    "peak_mg": "largest V_x, mg",
    "force_mn": "largest normal force, mN",
}


def figures(sensor: Sensor, height_mm: float, depth_mm: float) -> dict[str, float]:
    """SHOWN of the first accelerometer, for X-slides forth and back; NaN where no equilibrium is found."""
    along = np.arange(-sensor.chamber_mm[0] / 2, sensor.chamber_mm[0] / 2 + STEP_MM / 2, STEP_MM)
    offset = sensor.accelerometers[0].y_mm + OFFSET_MM
    try:
        pressure, inflated = skin_of(sensor).inflate_to(height_mm)
    except NoEquilibrium:
        return dict.fromkeys(SHOWN, np.nan)
    lines = [Line(0, sense, offset) for sense in (1, -1)]
    solved = [solve_line(sensor, line, along, depth_mm, pressure, inflated)[0] for line in lines]
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


def draw(rows: Mapping[str, Mapping[str, float]], out: Path) -> None:
    """Writes a column of bars for each figure, of the kind that the name's ending says (.svg, .png, .pdf)."""
    figure, axes = plt.subplots(1, len(SHOWN), sharey=True, figsize=(15, 7), layout="constrained")
    places = np.arange(len(rows))[::-1]
    for ax, (name, title) in zip(axes, SHOWN.items(), strict=True):
        values = [row[name] for row in rows.values()]
        ax.barh(places, values, color=["#c44" if change == "design" else "#48a" for change in rows])
        ax.axvline(values[0], color="k", lw=0.8, ls=":")
        for place, value in zip(places, values, strict=True):
            text = "no equilibrium" if np.isnan(value) else f"{value:.3g}"
            ax.text(0.02, place, text, transform=ax.get_yaxis_transform(), va="center", fontsize=7)
        ax.set_title(title, fontsize=9)
    axes[0].set_yticks(places, list(rows), fontsize=8)
    figure.savefig(out)
    plt.close(figure)


def sensitivity(sensor: Sensor, picture: Path | None = None) -> Iterator[Part]:
    """SHOWN for each of CHANGES. picture: drawn at the end."""
    rows = {}
    for name, part, values in CHANGES:
        rows[name] = figures(*changed(sensor, part, values))
        yield name, rows[name]
    if picture is not None:
        draw(rows, picture)


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("skin_sensitivity", __doc__)
    design = "the design (default: the article's sensor)"
    words.add_argument("--sensor", type=Path, default=DEFAULT_SENSOR, metavar="sensor.toml", help=design)
    words.add_argument("--picture", type=Path, metavar="FILE", help="draw it too: .svg, .png or .pdf")
    return run(words, lambda given: sensitivity(read_sensor(given.sensor), given.picture), argv)


if __name__ == "__main__":
    sys.exit(main())

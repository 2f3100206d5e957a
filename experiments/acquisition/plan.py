"""`softslide plan`: which slides to record, as a CSV for the stage and a picture."""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.acquisition.gcode import NEEDED, check_height
from softslide.experiments.acquisition.gcode import gcode as program_of
from softslide.experiments.acquisition.pictures import draw_plan
from softslide.experiments.acquisition.slides_to_test import draw_tests
from softslide.experiments.acquisition.waypoints import of_path, write_waypoints
from softslide.features.errors import InputError
from softslide.models.design.line_information import LEAST_CHORD_MM
from softslide.models.design.plan import Plan, plan_slides
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.at_rest import REFERENCE_V_PER_G
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.recordings.manifest import check_manifest, read_table
from softslide.pipeline.sensor import Sensor, check_design, read_sensor
from softslide.pipeline.staging import writing
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.slide_plan import crossing
from softslide.pipeline.synthesis.synthesize import path_plan

OFFSET_STEP_MM = 2.5  # between candidate lines of one direction, the map's own resolution
# What most stages can do.
DIRECTIONS_DEG = tuple(15.0 * n for n in range(24))
SPEEDS_MM_S = (1.0, 2.0, 4.0)
COLUMNS = (
    *("recording", "split", "direction_deg", "speed_mm_s", "offset_mm"),
    *("start_x_mm", "start_y_mm", "travel_mm", "depth_mm"),
)


@dataclass(frozen=True)
class SlidePlan:
    """slides: in the manifest's columns, those to learn from with the most useful first, those to test with among them.
    figures: what is expected of the former. sensor: theirs. paths: contacts along any path, of splits that are for
    reporting alone."""

    slides: pd.DataFrame
    figures: Plan
    sensor: Sensor
    paths: tuple[ContactPath, ...] = ()

    def to_frame(self) -> pd.DataFrame:
        """The slides."""
        return self.slides

    def plot(self, path: str | Path) -> None:
        """Draws the slides and paths from above, as the kind that the file's ending says."""
        draw_plan(self.slides, [path.course.places() for path in self.paths], self.sensor, Path(path))

    def write(self, out: str | Path) -> None:
        """Writes the CSV, and each path's waypoints (`waypoints.py`) into a folder next to it, which it names.

        Raises:
            InputError: they cannot be written.
        """
        out = Path(out)
        folder = out.with_name(f"{out.stem}-waypoints")
        rows = [
            {"recording": path.name, "split": path.split, "waypoints": f"{folder.name}/{path.name}.csv"}
            for path in self.paths
        ]
        with writing(out, "name another file"):
            for path, row in zip(self.paths, rows, strict=True):
                folder.mkdir(exist_ok=True)
                write_waypoints(out.parent / row["waypoints"], of_path(path))
            _in_turn(self.slides, pd.DataFrame(rows)).to_csv(out, index=False, lineterminator="\n")

    def lines(self) -> list[str]:
        """What the map is expected to add to the errors, without any slide and with these."""
        found = (("no slide", self.figures.before), ("these", self.figures.deviations))
        return [
            f"{name}: {math.degrees(direction):.2f} deg, {100 * speed:.2f} %, {offset:.3f} mm expected from the map"
            for name, (direction, speed, offset) in found
        ]


def plan(
    sensor: str | Path,
    slides: int = 12,
    *,
    atlas: str | Path | None = None,
    candidates: str | Path | None = None,
    directions_deg: Sequence[float] | None = None,
    speeds_mm_s: Sequence[float] | None = None,
    depth_mm: float = 0.5,
    tests: int = 0,
    paths: int = 0,
    out: str | Path | None = None,
    picture: str | Path | None = None,
    gcode: str | Path | None = None,
    firmware: str = "marlin",
) -> "SlidePlan":
    """The slides to record. out: a CSV of them, to write; picture: of them, to draw; gcode: a program, to write.
    directions_deg, speeds_mm_s: of the stage; None: DIRECTIONS_DEG, SPEEDS_MM_S. Lines are chosen for the middle speed,
    and take the speeds in turn: slides of one speed do not show the skin's lag (experiments/LOG.md).

    atlas: of the design; None: as `pipeline.atlas.library.atlas_of` finds it. candidates: a manifest, of which the
    slides of calibration and train splits may be chosen; None: lines in all directions over the chamber. tests: how
    many slides of split `test` (slides_to_test.py). paths: how many contacts of other kinds, that stop, press, bend,
    are put down or lifted, for a stage to follow. All kinds are spread evenly, since outputs at rest drift meanwhile.

    Raises:
        InputError: the sensor, the atlas or the candidates are wrong, or these are fewer than `slides`.
    """
    design = read_sensor(sensor)
    check_design(design, str(sensor))
    if slides < 1:
        raise InputError(f"{slides}: plan at least one", "slides")
    for count, name in ((tests, "tests"), (paths, "paths")):
        if count < 0:
            raise InputError(f"{count}: it must not be negative", name)
    speeds, directions = sorted(speeds_mm_s or SPEEDS_MM_S), directions_deg or DIRECTIONS_DEG
    table = (
        _lines(design, directions, speeds[len(speeds) // 2], depth_mm)
        if candidates is None
        else _recorded(Path(candidates), design)
    )
    if len(table) < slides:
        raise InputError(f"{slides}: there are {len(table)} candidates; take fewer slides", "slides")
    print(f"{len(table)} candidates", file=sys.stderr)
    # The map is calibrated in volts of this sensitivity (pipeline/recordings/at_rest.py).
    sensitivity = float(np.median([a.sensitivity_v_per_g for a in design.accelerometers]))
    solved = atlas_of(design, atlas)
    # At one speed: slow slides say the most of the map, and nothing of the lag.
    chosen = plan_slides(
        table.assign(speed_mm_s=table["speed_mm_s"].median()),
        slides,
        design.scaled(REFERENCE_V_PER_G / sensitivity),
        solved,
        depth_mm,
        CalibrationConfig(),
        SensorSpread(),
        progress=lambda steps: progress_bar("planning", "slide", steps),
    )
    picked = table.iloc[chosen.chosen]
    if candidates is None:
        in_turn = list(islice(cycle(speeds), slides))
        picked = picked.assign(recording=[f"p{n:02d}" for n in range(1, slides + 1)], speed_mm_s=in_turn)
    drawn = tuple(_paths(paths, design, solved, depth_mm))
    picked = picked[list(COLUMNS)]
    kept_apart = draw_tests(tests, picked, design, directions, speeds, depth_mm)
    planned = SlidePlan(_in_turn(picked, kept_apart), chosen, design, drawn)
    if out:
        planned.write(out)
    if picture:
        planned.plot(picture)
    if gcode:
        check_height(design, "gcode")
        program = program_of(planned.slides, firmware)
        with writing(Path(gcode), "name another file"):
            Path(gcode).write_text(program, encoding="ascii")
    return planned


def _in_turn(first: pd.DataFrame, second: pd.DataFrame) -> pd.DataFrame:
    """The rows of both, each table's spread evenly in its order."""
    if second.empty:
        return first
    places = [(k + 0.5) / len(table) for table in (first, second) for k in range(len(table))]
    return pd.concat([first, second]).iloc[np.argsort(places, kind="stable")]


def _lines(
    sensor: Sensor, directions_deg: Sequence[float], speed_mm_s: float, depth_mm: float
) -> pd.DataFrame:
    """Every line of the directions over the chamber, OFFSET_STEP_MM apart."""
    reach = float(np.hypot(*sensor.chamber_mm)) / 2 + float(np.hypot(*sensor.reference_mm))
    steps = np.arange(-np.floor(reach / OFFSET_STEP_MM), np.floor(reach / OFFSET_STEP_MM) + 1)
    rows = []
    for direction in directions_deg:
        for offset in OFFSET_STEP_MM * steps:
            line = crossing(direction % 360.0, offset, sensor)
            if line is None or line[2] < LEAST_CHORD_MM:
                continue
            (x, y), travel, _ = line
            rows.append(("", "calibration", direction % 360.0, speed_mm_s, offset, x, y, travel, depth_mm))
    return pd.DataFrame(rows, columns=list(COLUMNS)).round(3)


def _paths(count: int, sensor: Sensor, atlas: Atlas, depth_mm: float) -> Iterator[ContactPath]:
    """Paths of all kinds in turn, the same for the same design."""
    distribution = Distribution(depth_mm=depth_mm, uneven=0.0, pressure_share=(1.0, 1.0))
    for number in range(count):
        path = path_plan(number, 0, atlas, sensor, distribution)
        yield replace(path, name=f"track{number + 1:02d}")


def _recorded(path: Path, sensor: Sensor) -> pd.DataFrame:
    """A manifest's slides of calibration and train splits that have the labels a plan needs."""
    table = check_manifest(read_table(path), sensor, path)
    learned = table["split"].str.startswith(CALIBRATION)
    return table[learned & table[list(NEEDED)].notna().all(axis=1)].reset_index()

"""The map of a grid of presses: what the columns are, and which presses make which slides."""

from dataclasses import dataclass, field
from pathlib import Path

from softslide.pipeline.importers.import_map import check_channels
from softslide.pipeline.ranges import check_one_of
from softslide.pipeline.sensor import Sensor, read_sensor
from softslide.pipeline.toml_tables import from_table, read_toml

COLOURS = ("even", "odd", "any")
PATHS = ("lines", "circles", "s-curves")


@dataclass(frozen=True)
class PressChannel:
    """`[channels.a0_vx]`: the column of an output's change between rest and press, and that of its reading at rest."""

    column: str
    rest: str


@dataclass(frozen=True)
class GridSplit:
    """`[[split]]`: slides of one split.

    passes: whose presses they show, one pass a slide. colour: of the checkerboard whose places they show, "even", "odd"
    (the sum of a place's numbers in the grid) or "any". paths: "lines" in the 16 lattice directions, "circles" or
    "s-curves", with their truth. count: how many; 0: every line.
    """

    name: str
    passes: tuple[int, ...]
    colour: str = "any"
    paths: str = "lines"
    count: int = 0

    def __post_init__(self) -> None:
        check_one_of(COLOURS, colour=self.colour)
        check_one_of(PATHS, paths=self.paths)
        if not self.passes:
            raise ValueError("passes is empty; name one at least")
        if self.count < 0 or (self.paths != "lines" and self.count == 0):
            raise ValueError(f"count is {self.count}; say how many {self.paths} to make")


@dataclass(frozen=True)
class GridMap:
    """The whole map. x, y, depth, pass: names of columns, mm; without a pass column all presses are of pass 0.

    surface_mm: where given, the column `depth` is a height, and the contact depth is surface_mm less it.
    speed_mm_s: bounds of the made speeds, log-uniform. rest_s: before the motion; half of it after. seed: of what is
    drawn.
    """

    path: Path
    kind: str
    sensor: Sensor
    channels: dict[str, PressChannel]
    splits: tuple[GridSplit, ...] = field(metadata={"key": "split"})
    x: str = "x_mm"
    y: str = "y_mm"
    depth: str = ""
    surface_mm: float | None = None
    passes: str = field(default="", metadata={"key": "pass"})
    speed_mm_s: tuple[float, float] = (15.0, 50.0)
    rest_s: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.sensor.base is not None:
            raise ValueError("sensor.toml has a [base], and a grid of presses none; take it out")
        check_channels(self.channels, self.sensor.channels)
        if not self.splits:
            raise ValueError("no [[split]] is given; say which slides to make")
        if not 0 < self.speed_mm_s[0] <= self.speed_mm_s[1]:
            raise ValueError(f"speed_mm_s is {list(self.speed_mm_s)}; write two positive speeds that rise")
        if not self.rest_s >= 0.5:
            raise ValueError(f"rest_s is {self.rest_s}; the static output needs half a second at least")


def read_grid_map(path: Path) -> GridMap:
    """Reads and validates a map with kind = "grid", and the `sensor.toml` that it names.

    Raises:
        InputError: as `pipeline.importers.import_map.read_map`.
    """
    table = read_toml(path, "name a map, or start from a template")
    sensor = read_sensor(path.parent / str(table.pop("sensor", "sensor.toml")))
    return from_table(GridMap, table, str(path), path=path, sensor=sensor)

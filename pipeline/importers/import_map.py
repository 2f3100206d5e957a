"""The map: a TOML that says what a lab's files mean, as frozen dataclasses. Unknown keys are errors."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import re2

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.delimited import CsvLayout
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.readers.workbook import ExcelLayout
from softslide.pipeline.ranges import check_one_of, check_positive
from softslide.pipeline.recordings.manifest import LABELS
from softslide.pipeline.sensor import Sensor, read_sensor
from softslide.pipeline.toml_tables import from_table, read_toml

# Units of time, each in a second; a timestamp counts as nanoseconds.
PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000, "timestamp": 1_000_000_000}
# "own": the unit that sensor.toml says; of accelerometers it is V.
SIGNAL_UNITS = ("V", "mV", "g", "m/s2", "counts", "own")


@dataclass(frozen=True)
class Clock:
    """`[time]`: the column of times and its unit, or `rate_hz` where the file has none.

    origin: "kept" leaves the times as they count, "first" counts from the first sample (timestamps always
    do). max_gap_s: a longer gap is an error, a shorter one is bridged by a straight line and reported.
    align: "onset" sets the labelled moments of motion onto the onset in the signal, for a stage whose clock
    is not the DAQ's.
    """

    column: str = ""
    unit: str = "s"
    rate_hz: float = 0.0
    origin: str = "kept"
    max_gap_s: float = 0.1
    align: str = "none"

    def __post_init__(self) -> None:
        check_one_of(tuple(PER_SECOND), unit=self.unit)
        check_one_of(("kept", "first"), origin=self.origin)
        check_one_of(("none", "onset"), align=self.align)
        check_positive(self, "max_gap_s")
        if bool(self.column) == (self.rate_hz > 0):
            raise ValueError("give either column or rate_hz")


@dataclass(frozen=True)
class Signal:
    """`[channels.a0_vx]`: where one output is. part: which file, where a slide has several."""

    column: str
    unit: str = "V"
    part: str = ""
    volts_per_count: float = 0.0
    zero_count: float = 0.0

    def __post_init__(self) -> None:
        check_one_of(SIGNAL_UNITS, unit=self.unit)
        if (self.unit == "counts") != (self.volts_per_count > 0):
            raise ValueError(
                "volts_per_count belongs to the unit counts, and only to it; give the volts of one count"
            )


@dataclass(frozen=True)
class Board:
    """`[boards.a0]`: how an accelerometer is mounted, and its calibration.

    flip: outputs whose sign is inverted, before the rotation. turn_deg: the board's x axis seen from the
    skin's, counter-clockwise. calibration: a six-position file, next to the map.
    """

    turn_deg: float = 0.0
    flip: tuple[str, ...] = ()
    calibration: str = ""

    def __post_init__(self) -> None:
        for axis in self.flip:
            check_one_of(("x", "y", "z"), flip=axis)


@dataclass(frozen=True)
class Label:
    """`[labels.speed_mm_s]`: a fixed value, a column, a group of pattern, or a sheet's column.

    values: what a text stands for, as in {XF = 0, XB = 180}. scale: multiplies a number, for other units.
    """

    value: str | float | None = None
    column: str = ""
    name: str = ""
    sheet: str = ""
    values: dict[str, str | float] = field(default_factory=dict)
    scale: float = 1.0

    def __post_init__(self) -> None:
        if (self.value is not None) + bool(self.column) + bool(self.name) + bool(self.sheet) != 1:
            raise ValueError("give exactly one of value, column, name, sheet")


@dataclass(frozen=True)
class Sheet:
    """`[sheet]`: a table with one row a recording, in delimited text next to the map."""

    file: str
    key: str = "recording"
    delimiter: str = ","
    decimal: str = "."


@dataclass(frozen=True)
class Map:
    """The whole map. signs: "zones" flips outputs that the labelled slides show inverted, "given" none."""

    path: Path
    kind: str
    sensor: Sensor
    time: Clock
    channels: dict[str, Signal]
    pattern: str = ""
    signs: str = "given"
    csv: CsvLayout = field(default_factory=CsvLayout)
    xlsx: ExcelLayout = field(default_factory=ExcelLayout)
    boards: dict[str, Board] = field(default_factory=dict)
    labels: dict[str, Label] = field(default_factory=dict)
    sheet: Sheet | None = None

    def __post_init__(self) -> None:
        check_one_of(tuple(READERS), kind=self.kind)
        check_one_of(("given", "zones"), signs=self.signs)
        groups = set(compiled(self.pattern).groupindex)
        check_channels(self.channels, self.sensor.columns)
        check_known("boards", self.boards, tuple(a.name for a in self.sensor.parts))
        check_known("labels", self.labels, ("recording", "split", *LABELS))
        for name, label in self.labels.items():
            if label.name and label.name not in groups:
                raise ValueError(
                    f"[labels.{name}] names the group '{label.name}', which pattern does not have"
                )
            if name == "recording" and not label.name:
                raise ValueError(
                    "[labels.recording] needs name, a group of pattern; a file holds one recording"
                )
            if label.sheet and self.sheet is None:
                raise ValueError(f"[labels.{name}] names a sheet's column; add [sheet] with its file")
        if any(s.part for s in self.channels.values()) and "part" not in groups:
            raise ValueError("a channel has a part, so pattern needs a group (?P<part>...) that finds it")
        if self.kind == "ros" and not self.time.column:
            raise ValueError("[time] column is missing; write header.stamp or received")
        for name in (a.name for a in self.sensor.parts):
            units = {self.channels[f"{name}_v{axis}"].unit in ("g", "m/s2") for axis in "xyz"}
            if len(units) > 1:
                raise ValueError(f"the channels of {name} mix volts and accelerations; give one kind")


def read_map(path: Path) -> Map:
    """Reads and validates a map, and the `sensor.toml` that it names.

    Raises:
        InputError: a file is missing or no TOML, a key is unknown or missing, a value is wrong.
    """
    table = read_toml(path, "name a map, or start from a template")
    sensor = table.pop("sensor", None)
    if not isinstance(sensor, str):
        raise InputError(
            f'{path}: sensor is {sensor!r}; write sensor = "sensor.toml", a file next to the map'
        )
    for kind in ("csv", "xlsx"):
        if kind in table and table.get("kind") != kind:
            raise InputError(f'{path}: [{kind}] belongs to kind = "{kind}"; remove it')
    return from_table(Map, table, str(path), path=path, sensor=read_sensor(path.parent / sensor))


def compiled(pattern: str) -> Any:
    """The pattern in RE2's syntax, which takes a time in proportion to the name that it is looked for in.

    Raises:
        ValueError: it is no regular expression, or has what RE2 lacks: looking ahead, looking back, repeats of groups.
    """
    quiet = re2.Options()
    quiet.log_errors = False
    try:
        return re2.compile(pattern, quiet)
    except re2.error as error:
        (reason,) = error.args
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else reason
        raise ValueError(f"pattern is not a regular expression of RE2 ({text})") from None


def template(kind: str) -> str:
    """A commented map to start from; of kind "sensor" a commented `sensor.toml`."""
    names = (kind,) if kind in ("grid", "sensor") else (kind, "labels")
    folder = Path(__file__).parent / "templates"
    return "".join((folder / f"{name}.toml").read_text(encoding="utf-8") for name in names)


def check_channels(channels: dict[str, Any], outputs: tuple[str, ...]) -> None:
    """Raises ValueError where an output of the sensor is not in the map, or what is in it is not an output."""
    if absent := [output for output in outputs if output not in channels]:
        raise ValueError(f"[channels.{absent[0]}] is missing; say where the sensor's output is")
    check_known("channels", channels, outputs)


def check_known(name: str, given: dict[str, Any], known: tuple[str, ...]) -> None:
    """Raises ValueError where a table of the map has a key that is not known."""
    if unknown := [key for key in given if key not in known]:
        raise ValueError(f"unknown key '{name}.{unknown[0]}'; known are {', '.join(known)}")

"""A sensor as `sensor.toml` describes it: its geometry, its accelerometers, its electronics."""

import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from features.errors import InputError


@dataclass(frozen=True)
class Accelerometer:
    """One three-axis accelerometer cast into the skin, at (x_mm, y_mm) from the chamber's centre."""

    name: str
    x_mm: float
    y_mm: float
    model: str = "MMA7361L"
    sensitivity_v_per_g: float = 0.8
    zero_g_v: float = 1.65

    def __post_init__(self) -> None:
        if not self.sensitivity_v_per_g > 0:
            raise ValueError(f"sensitivity_v_per_g is {self.sensitivity_v_per_g}; it must be positive")


@dataclass(frozen=True)
class Sensor:
    """The contract's `sensor.toml`. Lengths in mm, pressure in MPa, rate in Hz, ADC step in V."""

    name: str
    sample_rate_hz: float
    chamber_mm: tuple[float, float]
    skin_thickness_mm: float
    indenter_diameter_mm: float
    pressure_mpa: float
    reference_mm: tuple[float, float]
    adc_step_v: float
    accelerometers: tuple[Accelerometer, ...]

    def __post_init__(self) -> None:
        for name in ("sample_rate_hz", "skin_thickness_mm", "indenter_diameter_mm", "pressure_mpa"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be positive")
        if not self.adc_step_v >= 0:
            raise ValueError(f"adc_step_v is {self.adc_step_v}; it must not be negative")
        if len(self.chamber_mm) != 2 or not min(self.chamber_mm) > 0:
            raise ValueError(f"chamber_mm is {list(self.chamber_mm)}; it must be two positive lengths")
        if len(self.reference_mm) != 2:
            raise ValueError(f"reference_mm is {list(self.reference_mm)}; it must be x and y")
        if not self.accelerometers:
            raise ValueError("no [[accelerometer]] is given; a sensor has at least one")
        names = [a.name for a in self.accelerometers]
        if len(set(names)) != len(names):
            raise ValueError(f"two accelerometers share a name ({', '.join(names)}); name each differently")

    @property
    def channels(self) -> tuple[str, ...]:
        """Column names of the voltages in order: a0_vx, a0_vy, a0_vz, a1_vx, ..."""
        return tuple(f"{a.name}_v{axis}" for a in self.accelerometers for axis in "xyz")


def read_sensor(path: Path) -> Sensor:
    """Reads and validates a `sensor.toml`.

    Raises:
        InputError: the file is missing, is no TOML, misses a key, holds an unknown one or a bad value.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a folder of recordings needs a sensor.toml") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a TOML file ({error}); mend its syntax") from None
    rows = table.pop("accelerometer", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"{path}: accelerometer is not a list of tables; write [[accelerometer]]")
    parts = tuple(
        _from_table(Accelerometer, row, f"{path}: [[accelerometer]] {n}") for n, row in enumerate(rows, 1)
    )
    return _from_table(Sensor, {**table, "accelerometers": parts}, str(path))


def write_sensor(path: Path, sensor: Sensor) -> None:
    """Writes a `sensor.toml` that `read_sensor` reads back as the same sensor."""
    import tomli_w

    table = asdict(sensor)
    table["accelerometer"] = table.pop("accelerometers")
    path.write_text(tomli_w.dumps(table), encoding="utf-8")


def _from_table(kind: type, table: dict[str, Any], place: str) -> Any:
    """Builds a dataclass from a TOML table: unknown keys, missing keys and wrong types are errors."""
    known = {f.name: f for f in fields(kind)}
    if unknown := sorted(set(table) - set(known)):
        raise InputError(f"{place}: unknown key '{unknown[0]}'; known are {', '.join(known)}")
    values: dict[str, Any] = {}
    for name, value in table.items():
        expected = known[name].type
        if expected is float:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError(f"{place}: {name} is {value!r}; write a number")
            value = float(value)
        elif expected is str and not isinstance(value, str):
            raise InputError(f"{place}: {name} is {value!r}; write a text in quotes")
        elif expected == tuple[float, float]:
            if not isinstance(value, list) or not all(
                isinstance(v, int | float) and not isinstance(v, bool) for v in value
            ):
                raise InputError(f"{place}: {name} is {value!r}; write [x, y] in numbers")
            value = tuple(float(v) for v in value)
        values[name] = value
    try:
        return kind(**values)
    except TypeError:
        required = [f.name for f in fields(kind) if f.name not in values and f.default is f.default_factory]
        raise InputError(f"{place}: {', '.join(required)} missing; add it") from None
    except ValueError as error:
        raise InputError(f"{place}: {error}") from None

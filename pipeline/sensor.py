"""A sensor as `sensor.toml` describes it: its geometry, its sensing elements, its electronics, its mechanics.

The mechanics (`[skin]`, `[board]`, `[mesh]`) are optional: their defaults are the article's sensor, so that a
folder of recordings can be simulated from the `sensor.toml` that it has.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from softslide.features.base_motion import BASE
from softslide.features.errors import InputError
from softslide.features.names import check_plain
from softslide.features.stream.conditioning import TOUCH_AXES
from softslide.pipeline.ranges import SHARE, check_one_of, check_positive, check_ranges
from softslide.pipeline.toml_tables import from_table, read_toml

# Noise density of an accelerometer by its data sheet, g / sqrt(Hz). MMA7361L: Freescale, rev. 0, 350 ug / sqrt(Hz).
NOISE_G_RTHZ = {"MMA7361L": 350e-6}
# Skin left between a board and the clamped rim, and between two boards: less would be a sliver of an element.
RIM_MM = 0.5
_BOARD_GAP_MM = 0.5
# Of skin on the base: a wider border adds elements that hardly move.
MOST_OVERLAP_MM = 20.0


KINDS = ("accelerometer", "magnetometer", "other")
# What a folder's recordings are: of a real skin, of an emulator, put together from real measurements, of our simulator.
ORIGINS = ("measured", "emulated", "assembled", "synthetic")


@dataclass(frozen=True)
class Accelerometer:
    """One three-axis sensing element in the skin, at (x_mm, y_mm) from the chamber's centre: an `[[accelerometer]]`.

    kind: what it is. An accelerometer measures gravity and its V_x and V_y answer to a touch: contact zones, drift by
    gravity, the solved skin and the article's interpolation apply to it alone. Of other kinds nothing but the answer
    is assumed.
    unit: of its three outputs; where it is no V, whatever else is called volts is in this unit.
    touch_axes: which outputs answer to a touch, "xy" or "xyz"; of an accelerometer "xy" unless given, of others "xyz".
    model, sensitivity_v_per_g, zero_g_v: of an accelerometer; they say nothing of other kinds.
    """

    name: str
    x_mm: float
    y_mm: float
    model: str = "MMA7361L"
    sensitivity_v_per_g: float = 0.8
    zero_g_v: float = 1.65
    kind: str = KINDS[0]
    unit: str = "V"
    touch_axes: str = ""

    def __post_init__(self) -> None:
        check_positive(self, "sensitivity_v_per_g")
        check_one_of(KINDS, kind=self.kind)
        if not self.touch_axes:
            object.__setattr__(self, "touch_axes", TOUCH_AXES[0 if self.measures_gravity else 1])
        check_one_of(TOUCH_AXES, touch_axes=self.touch_axes)

    @property
    def measures_gravity(self) -> bool:
        """Whether it reads 1 g at rest."""
        return self.kind == KINDS[0]


@dataclass(frozen=True)
class Base:
    """`[base]`: an accelerometer, of an IMU for instance, on what the skin is mounted on: it shows how that moves. Of a
    skin of magnetometers a magnetometer where no contact shows: it measures the field of the earth and of iron nearby.

    kind: which of the two. Of a magnetometer the other two say nothing; its outputs are in the unit of the skin's.
    """

    sensitivity_v_per_g: float = 0.8
    zero_g_v: float = 1.65
    kind: str = KINDS[0]

    def __post_init__(self) -> None:
        check_positive(self, "sensitivity_v_per_g", "zero_g_v")
        check_one_of(KINDS[:2], kind=self.kind)

    @property
    def measures_gravity(self) -> bool:
        """Whether it reads 1 g at rest."""
        return self.kind == KINDS[0]

    @property
    def name(self) -> str:
        """What its columns begin with."""
        return BASE


@dataclass(frozen=True)
class Skin:
    """`[skin]`: Ecoflex 00-10 as the article has it. Moduli and pressures in MPa, lengths in mm.

    The skin is nearly incompressible, so its shear modulus is a third of Young's; the bulk modulus is high
    enough to keep the volume within a percent and low enough to solve well. The atlas is solved at each of
    `height_mm` (the inflated skin's highest point over its flat state); `effective_pressure_mpa` states the
    pressures themselves instead. Neither is the regulator's figure `pressure_mpa`: a neo-Hookean skin of
    the article's modulus would balloon long before 35 kPa, so the height is what ties the model to a real
    skin.

    overlap_mm: how far the skin goes on beyond the chamber, bonded to the base by its lower face; 0: it is clamped at
    the chamber's edge over its whole thickness.
    base_mpa_mm: traction over displacement of the base under the overlap, normal and tangential to it (a Winkler
    foundation); none: a rigid base.
    prestretch: how far the skin was stretched along x and y before it was mounted; lengths are as mounted.
    """

    youngs_modulus_mpa: float = 0.07
    bulk_modulus_mpa: float = 2.0
    friction: float = 0.2
    overlap_mm: float = 0.0
    base_mpa_mm: tuple[float, ...] = ()
    prestretch: float = 1.0
    height_mm: tuple[float, ...] = (5.0, 7.0, 9.6)
    effective_pressure_mpa: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        check_positive(self, "youngs_modulus_mpa", "bulk_modulus_mpa")
        check_ranges(self, friction=SHARE, overlap_mm=(0.0, MOST_OVERLAP_MM), prestretch=(0.8, 1.5))
        if self.base_mpa_mm and (len(self.base_mpa_mm) != 2 or not min(self.base_mpa_mm) > 0):
            raise ValueError(
                f"base_mpa_mm is {list(self.base_mpa_mm)}; it must be two positive stiffnesses, normal and tangential"
            )
        if self.base_mpa_mm and not self.overlap_mm:
            raise ValueError("base_mpa_mm is given without overlap_mm: nothing of the skin lies on the base")
        for name in ("height_mm", "effective_pressure_mpa"):
            levels = getattr(self, name)
            if any(v <= 0 for v in levels) or any(b <= a for a, b in pairwise(levels)):
                raise ValueError(f"{name} is {list(levels)}; it must be positive and rise")
        if not self.height_mm and not self.effective_pressure_mpa:
            raise ValueError(
                "neither height_mm nor effective_pressure_mpa has a value; give one level at least"
            )

    @property
    def shear_modulus_mpa(self) -> float:
        """G = E / 3, of an incompressible solid."""
        return self.youngs_modulus_mpa / 3.0


# Of a skin: what an atlas is solved at, and what it can do without.
_LEVELS = ("height_mm", "effective_pressure_mpa")
_OPTIONAL = ("overlap_mm", "base_mpa_mm", "prestretch")


@dataclass(frozen=True)
class Board:
    """`[board]`: the accelerometers' boards, all alike, cast into the skin's middle. Lengths in mm."""

    size_mm: tuple[float, float] = (10.0, 10.0)
    thickness_mm: float = 1.7

    def __post_init__(self) -> None:
        check_positive(self, "size_mm", "thickness_mm")


@dataclass(frozen=True)
class MeshSize:
    """`[mesh]`: elements of about `size_mm` in the plane, `layers` each below, in and above the boards."""

    size_mm: float = 2.5
    layers: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, size_mm=(0.5, 5.0), layers=(1, 4))


@dataclass(frozen=True)
class Sensor:
    """A sensor: `sensor.toml`. Lengths in mm, pressure in MPa, rate in Hz, ADC step in V.

    origin: what the recordings are, one of ORIGINS; "": not said.
    """

    name: str
    sample_rate_hz: float
    chamber_mm: tuple[float, float]
    skin_thickness_mm: float
    indenter_diameter_mm: float
    pressure_mpa: float
    reference_mm: tuple[float, float]
    adc_step_v: float
    accelerometers: tuple[Accelerometer, ...] = field(metadata={"key": "accelerometer"})
    skin: Skin = Skin()
    board: Board = Board()
    mesh: MeshSize = MeshSize()
    # Of the place where it is used, in Hz; None: found in the recordings at rest.
    mains_hz: float | None = None
    origin: str = ""
    # None: the recordings have no columns of it.
    base: Base | None = None
    # The indenter's lower end is a ball, or an edge: the ball swept along this vector, which is along x or y.
    indenter_edge_mm: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        if min(map(abs, self.indenter_edge_mm)) > 0:
            raise ValueError(
                f"indenter_edge_mm is {list(self.indenter_edge_mm)}; it must be a length along x or along y and a 0"
            )
        if self.mains_hz not in (None, 50.0, 60.0):
            raise ValueError(f"mains_hz is {self.mains_hz:g}; it must be 50 or 60")
        check_positive(
            self, "sample_rate_hz", "chamber_mm", "skin_thickness_mm", "indenter_diameter_mm", "pressure_mpa"
        )
        if not self.adc_step_v >= 0:
            raise ValueError(f"adc_step_v is {self.adc_step_v}; it must not be negative")
        if not self.accelerometers:
            raise ValueError("no [[accelerometer]] is given; a sensor has at least one")
        names = [a.name for a in self.accelerometers]
        for name in (self.name, *names, *(a.model for a in self.accelerometers)):
            check_plain(name, "a name")
        if BASE in names:
            raise ValueError(
                f"an accelerometer of the skin is named '{BASE}', as the robot's under [base]; rename it"
            )
        if len(set(names)) != len(names):
            raise ValueError(f"two accelerometers share a name ({', '.join(names)}); name each differently")
        if len({(a.touch_axes, a.unit) for a in self.accelerometers}) > 1:
            raise ValueError(
                "the accelerometers differ in touch_axes or unit; make a folder of each, or state the same"
            )
        if self.base is not None and not self.base.measures_gravity and self.measures_gravity:
            raise ValueError(
                "[base] is a magnetometer, which does not show what tilts accelerometers; give one of these"
            )
        check_one_of(("", *ORIGINS), origin=self.origin)

    @property
    def channels(self) -> tuple[str, ...]:
        """Column names of the voltages in order: a0_vx, a0_vy, a0_vz, a1_vx, ..."""
        return tuple(f"{a.name}_v{axis}" for a in self.accelerometers for axis in "xyz")

    @property
    def parts(self) -> tuple["Accelerometer | Base", ...]:
        """The sensing elements, and the base where there is one: each with three of `columns`."""
        return self.accelerometers if self.base is None else (*self.accelerometers, self.base)

    @property
    def columns(self) -> tuple[str, ...]:
        """Column names of all that is recorded: the channels, and base_vx, base_vy, base_vz where there is a base."""
        return tuple(f"{part.name}_v{axis}" for part in self.parts for axis in "xyz")

    def scaled(self, scale: float) -> "Sensor":
        """The sensor whose volts are `scale` times as many: `scale` of features/stream/conditioning.py is applied."""
        parts = (
            replace(a, sensitivity_v_per_g=scale * a.sensitivity_v_per_g, zero_g_v=scale * a.zero_g_v)
            for a in self.accelerometers
        )
        return replace(self, accelerometers=tuple(parts))

    @property
    def touch_axes(self) -> str:
        """Of every sensing element: the outputs that answer to a touch."""
        return self.accelerometers[0].touch_axes

    @property
    def measures_gravity(self) -> bool:
        """Whether every sensing element is an accelerometer."""
        return all(a.measures_gravity for a in self.accelerometers)


def read_sensor(path: str | Path) -> Sensor:
    """Reads and validates a `sensor.toml`.

    Raises:
        InputError: the file is missing, is no TOML, misses a key, holds an unknown one or a bad value.
    """
    remedy = "a folder of recordings and a design need a sensor.toml"
    return from_table(Sensor, read_toml(Path(path), remedy), str(path))


def check_design(sensor: Sensor, source: str = "sensor") -> None:
    """What recordings can do without and mechanics cannot: accelerometers, each one's board in the chamber's skin, none
    in another.

    Raises:
        InputError: a sensing element is not an accelerometer; a board is thicker than the skin leaves room for, reaches
            over the chamber, or overlaps.
    """
    for n, a in enumerate(sensor.accelerometers, 1):
        if not a.measures_gravity:
            raise InputError(
                f"{source}: accelerometer {n}: '{a.name}' is of kind '{a.kind}'; the solved skin tilts accelerometers "
                "alone, others are calibrated from recordings"
            )
    width, length = sensor.board.size_mm
    if sensor.board.thickness_mm > 0.8 * sensor.skin_thickness_mm:
        raise InputError(
            f"{source}: [board] thickness_mm is {sensor.board.thickness_mm:g} in a skin of "
            f"{sensor.skin_thickness_mm:g}; at most four fifths of the skin can be board"
        )
    for n, a in enumerate(sensor.accelerometers):
        if (
            abs(a.x_mm) + width / 2 > sensor.chamber_mm[0] / 2 - RIM_MM
            or abs(a.y_mm) + length / 2 > sensor.chamber_mm[1] / 2 - RIM_MM
        ):
            raise InputError(
                f"{source}: accelerometer {n + 1}: the board of '{a.name}' at ({a.x_mm:g}, {a.y_mm:g}) "
                f"is not within the chamber by {RIM_MM:g} mm; move it or shrink [board] size_mm"
            )
        for b in sensor.accelerometers[:n]:
            if abs(a.x_mm - b.x_mm) < width + _BOARD_GAP_MM and abs(a.y_mm - b.y_mm) < length + _BOARD_GAP_MM:
                raise InputError(
                    f"{source}: accelerometer {n + 1}: the boards of '{b.name}' and '{a.name}' overlap "
                    f"or lie closer than {_BOARD_GAP_MM:g} mm; move one"
                )


def write_sensor(path: Path, sensor: Sensor) -> None:
    """Writes a `sensor.toml` that `read_sensor` reads back as the same sensor."""
    import tomli_w

    path.write_text(tomli_w.dumps(_in_a_file(asdict(sensor))), encoding="utf-8")


def sensor_of(card: Mapping[str, Any], source: str) -> Sensor:
    """The sensor that a bundle's card holds.

    Raises:
        InputError: it is not as `sensor.toml` may be.
    """
    return from_table(Sensor, _in_a_file(card), source)


def _in_a_file(values: Mapping[str, Any]) -> dict[str, Any]:
    """A sensor's values as they stand in a `sensor.toml`: TOML has no null, what is not known is not written."""
    table = {key: value for key, value in values.items() if value not in (None, "")}
    table["accelerometer"] = table.pop("accelerometers")
    return table


def design_of(sensor: Sensor) -> dict[str, Any]:
    """What of a sensor decides its mechanics; names, electronics and the regulator's pressure do not.

    What a design can do without is in it only where it has it, so that one without it keeps its hash.
    """
    edge = {"indenter_edge_mm": list(sensor.indenter_edge_mm)} if any(sensor.indenter_edge_mm) else {}
    skin = {name: value for name, value in asdict(sensor.skin).items() if name not in _LEVELS}
    return {
        "chamber_mm": list(sensor.chamber_mm),
        "skin_thickness_mm": sensor.skin_thickness_mm,
        "indenter_diameter_mm": sensor.indenter_diameter_mm,
        **edge,
        "boards_mm": [[a.x_mm, a.y_mm] for a in sensor.accelerometers],
        "skin": {k: v for k, v in skin.items() if k not in _OPTIONAL or v != getattr(Skin, k)},
        "board": asdict(sensor.board),
    }


def design_hash(sensor: Sensor) -> str:
    """Sixteen hex digits of SHA-256 over the design."""
    return hashlib.sha256(json.dumps(design_of(sensor), sort_keys=True).encode()).hexdigest()[:16]

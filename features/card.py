"""The model card, model.json: all that a computer must know to run model.onnx."""

import json
import math
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from softslide.features.base_motion import BASE_COLUMNS, BaseMotion
from softslide.features.card_fields import check_fields
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.force_map import ForceMap
from softslide.features.digest import sha256
from softslide.features.errors import InputError
from softslide.features.height import HeightCalibration
from softslide.features.regular_file import read_regular
from softslide.features.stream.conditioning import ROUNDING, Conditioning

FORMAT = "softslide-model"
VERSION = 1
# A hundred times the largest card so far, which holds a calibrated response map.
MOST_BYTES = 1 << 26
# An integer of more decimal digits may be beyond a float.
MOST_DIGITS = 300
# Sample rates that are read, whatever the calibration's: below, a block of too few samples keeps too much noise
# (experiments/LOG.md).
RATES_HZ = (250.0, 100_000.0)
INPUTS = ("window", "features")
# Of direction, speed and distance: how many times as wide an interval is that holds for bends as well.
BENT = ("direction_bent", "log_speed_bent", "offset_bent")
UNITS = {
    "direction_cos": "1",
    "direction_sin": "1",
    "log_speed": "log(mm/s)",
    "log_speed_width": "log(mm)",
    "offset_mm": "mm",
    "along_mm": "mm",
    "depth_mm": "mm",
    "direction_sd_deg": "deg",
    "log_speed_sd": "1",
    "offset_sd_mm": "mm",
    "depth_sd_mm": "mm",
    "misfit": "1",
    "strain": "1",
    "straight": "1",
    **dict.fromkeys(BENT, "1"),
}

COVERAGE = 0.9  # of every interval
# Half a 90 % interval of a normal error, in standard deviations: the normal distribution's 95 % quantile.
HALF_WIDTH_SD = 1.645


@dataclass(frozen=True)
class Interval:
    """A 90 % interval's half-width: scale * sqrt(sd^2 + floor^2) * widening(strain), sd and strain the graph's own
    estimates (0 if it gives none)."""

    scale: float
    floor: float

    def half_width(self, sd: float, strain: float = 0.0) -> float:
        """In the unit of `floor` and `sd`."""
        return self.scale * math.hypot(sd, self.floor) * float(widening(strain))


def widening(strain: Any) -> Any:
    """How many times as wide intervals are, of one or (n,): a gain that is off by more than the standard deviation of
    calibration slides, `strain` of them, is of a contact that the map knows less well."""
    return np.maximum(strain, 1.0)


@dataclass(frozen=True)
class Validity:
    """Limits within which an estimate is valid; outside, the estimate's `valid` is false.

    speed_mm_s: range, mm/s. offset_mm: largest |offset|, mm. misfit: largest reduced chi-square.
    direction_sd_deg, log_speed_sd: largest standard deviations, deg and 1.
    peak_v: least |subtracted output| that the window has to reach, V. The default is 1.6 times the trigger.
    """

    speed_mm_s: tuple[float, float] = (0.3, 60.0)
    offset_mm: float = 25.0
    peak_v: float = 0.008
    misfit: float = math.inf
    direction_sd_deg: float = math.inf
    log_speed_sd: float = math.inf


@dataclass(frozen=True)
class Card:
    """What model.json holds.

    model: the model's name. input: "window" or "features", what the graph reads (INPUTS). outputs: the columns of the
    graph's row, keys of UNITS. sensor: as in sensor.toml. channels: a0_vx, a0_vy, a0_vz, a1_vx, ...
    reference_mm: the point that offsets are measured from. intervals: by quantity (direction_deg, log_speed,
    offset_mm, depth_mm). provenance: what the model was trained from. golden: one worked example, the graph's inputs
    by name and its row for them. graph_sha256: of the graph's file. contact: what contacts are tracked with, None:
    straight slides alone. force: of a contact by its place, None: not known. heights: of the skin, None: it is a
    model for one. base: how the outputs follow the base's, None: no base is read.

    Raises:
        ValueError: an unknown input or output, channels that are not the sensor's, or a field of another type or
            outside its range (features/card_fields.py).
    """

    model: str
    input: str
    outputs: tuple[str, ...]
    sensor: dict[str, Any]
    channels: tuple[str, ...]
    sample_rate_hz: float
    reference_mm: tuple[float, float]
    conditioning: Conditioning
    intervals: dict[str, Interval]
    validity: Validity
    provenance: dict[str, Any]
    golden: dict[str, Any]
    graph_sha256: str
    contact: ContactCalibration | None = None
    force: ForceMap | None = None
    heights: HeightCalibration | None = None
    base: BaseMotion | None = None

    def __post_init__(self) -> None:
        if self.input not in INPUTS:
            raise ValueError(f"input is '{self.input}'; known are {', '.join(INPUTS)}")
        if unknown := [name for name in self.outputs if name not in UNITS]:
            raise ValueError(f"output '{unknown[0]}' is unknown; known are {', '.join(UNITS)}")
        check_fields(self)

    @property
    def columns(self) -> tuple[str, ...]:
        """Of a sample, in order: the channels, and base_vx, base_vy, base_vz where a base is read."""
        return self.channels if self.base is None else self.channels + BASE_COLUMNS

    @property
    def block_samples(self) -> float:
        """Length of a block in samples: not always a whole number."""
        return self.conditioning.block_samples(self.sample_rate_hz)

    def at_rate(self, rate_hz: float, place: str = "") -> "Card":
        """The card for samples at another rate: the blocks that a model reads hold more of them, or fewer.

        place: of the rate in a file, which opens an error's message; none: it is a parameter.

        Raises:
            InputError: a rate outside RATES_HZ.
        """
        low, high = RATES_HZ
        if rate_hz == self.sample_rate_hz:
            return self
        if not low <= rate_hz <= high:
            text = (
                f"{rate_hz:.6g} Hz is not read: a block of {self.conditioning.block_s:g} s needs samples at "
            )
            text += f"{low:g} to {high:g} Hz"
            raise InputError(f"{place} {text}") if place else InputError(text, "rate_hz")
        return replace(self, sample_rate_hz=rate_hz)

    @property
    def samples_per_block(self) -> int:
        """Whole samples in one block at least: a chunk of this many completes one block at most."""
        return int(self.block_samples + ROUNDING)


def write_card(card: Card, path: Path) -> None:
    """Writes model.json with a hash of itself. Infinite limits become null: JSON has no infinity."""
    table = {"format": FORMAT, "version": VERSION, **asdict(card)}
    table["units"] = {name: UNITS[name] for name in card.outputs}
    table["validity"] = {k: None if v == math.inf else v for k, v in table["validity"].items()}
    table["card_sha256"] = card_hash(table)
    path.write_text(json.dumps(table, separators=(",", ":"), allow_nan=False) + "\n", encoding="utf-8")


def card_hash(table: dict[str, Any]) -> str:
    """SHA-256 of model.json's table without its key card_sha256, as JSON with sorted keys and no spaces.

    It finds what was altered by accident or by hand. It is no signature: who alters a card can compute it anew.
    """
    rest = {key: value for key, value in table.items() if key != "card_sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()


def read_card(path: Path, unsigned: bool = False) -> Card:
    """Reads and validates model.json. unsigned: also one that carries no hash of itself.

    Raises:
        InputError: the file is missing, no regular file, no JSON, or of another format or version; it is not what was
            written, or does not show it; a key is unknown or missing; a value is bad.
    """
    table = _table(path, unsigned)
    if table.pop("format", None) != FORMAT:
        raise InputError(f"{path}: not a softslide model card; name a bundle that 'softslide train' made")
    version = table.pop("version", None)
    if type(version) is not int or version != VERSION:
        raise InputError(
            f"{path}: card version {version!r:.40}, this release reads {VERSION}; export the bundle again"
        )
    table.pop("units", None)
    # Bundles made before contacts were tracked, or forces, heights or a base known, have no such section.
    for section in ("contact", "force", "heights", "base"):
        table.setdefault(section, None)
    if odd := sorted(set(table) ^ {f.name for f in fields(Card)}):
        raise InputError(f"{path}: key {odd[0]!r:.60} is missing or unknown; export the bundle again")
    try:
        return _card(table)
    except (TypeError, ValueError, AttributeError, KeyError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(
            f"{path}: a value does not fit ({reason}); train or export the bundle again"
        ) from None


def _table(path: Path, unsigned: bool) -> dict[str, Any]:
    """The file's table, without its hash, which is checked."""
    content = read_regular(path, MOST_BYTES, "a bundle holds model.onnx and model.json")
    try:
        table = json.loads(
            content.decode("utf-8"),
            object_pairs_hook=_unique,
            parse_int=_integer,
            parse_float=_finite,
            parse_constant=_finite,
        )
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:160]
        raise InputError(f"{path}: not a model card ({reason}); export the bundle again") from None
    if not isinstance(table, dict):
        raise InputError(f"{path}: not a softslide model card; name a bundle that 'softslide train' made")
    if "card_sha256" not in table and not unsigned:
        raise InputError(
            f"is needed to read {path}: it has no card_sha256, so that changes to it are not found; or train again",
            "unsigned",
        )
    if table.get("card_sha256", card_hash(table)) != card_hash(table):
        raise InputError(f"{path}: altered since it was written; take the bundle from its source again")
    table.pop("card_sha256", None)
    return table


def _card(table: dict[str, Any]) -> Card:
    limits = {name: math.inf if limit is None else limit for name, limit in table["validity"].items()}
    limits.pop("strain", None)  # a limit that bundles had until intervals grew with the strain
    return _typed(Card, {**table, "validity": limits})


def _typed(hint: Any, value: Any) -> Any:
    """What JSON holds for a field of this type: of a table a dataclass, of a list a tuple."""
    origin, kinds = get_origin(hint), get_args(hint)
    if origin is UnionType:
        return None if value is None else _typed(kinds[0], value)
    if is_dataclass(hint):
        hints = get_type_hints(hint)
        return hint(**{name: _typed(hints.get(name), item) for name, item in value.items()})  # type: ignore[operator]
    if origin is dict and isinstance(value, dict):
        return {name: _typed(kinds[1], item) for name, item in value.items()}
    if origin is tuple:
        if not isinstance(value, list):
            raise TypeError(f"{value!r:.40} is no list")
        return tuple(_typed(kinds[0], item) for item in value)
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        raise ValueError("a key comes twice")
    return table


def _integer(text: str) -> int:
    if len(text.lstrip("-")) > MOST_DIGITS:
        raise ValueError(f"an integer has more than {MOST_DIGITS} digits")
    return int(text)


def _finite(text: str) -> float:
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text:.40} is no finite number")
    return value

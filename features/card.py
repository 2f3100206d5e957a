"""The model card, model.json: all that a computer must know to run model.onnx."""

import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from features.errors import InputError
from features.stream.conditioning import ROUNDING, Conditioning

FORMAT = "softslide-model"
VERSION = 1
INPUTS = ("window", "features")
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
    "misfit": "1",
}


# Half a 90 % interval of a normal error, in standard deviations: the normal distribution's 95 % quantile.
HALF_WIDTH_SD = 1.645


@dataclass(frozen=True)
class Interval:
    """A 90 % interval's half-width: scale * sqrt(sd^2 + floor^2), sd the graph's own estimate (0 if it gives none)."""

    scale: float
    floor: float

    def half_width(self, sd: float) -> float:
        """In the unit of `floor` and `sd`."""
        return self.scale * math.hypot(sd, self.floor)


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
    offset_mm). provenance: what the model was trained from. golden: one worked example, the graph's inputs by name and
    its row for them. graph_sha256: of the graph's file.

    Raises:
        ValueError: an unknown input or output, or channels that are no whole number of accelerometers.
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

    def __post_init__(self) -> None:
        if self.input not in INPUTS:
            raise ValueError(f"input is '{self.input}'; known are {', '.join(INPUTS)}")
        if unknown := [name for name in self.outputs if name not in UNITS]:
            raise ValueError(f"output '{unknown[0]}' is unknown; known are {', '.join(UNITS)}")
        if not self.channels or len(self.channels) % 3:
            raise ValueError(f"{len(self.channels)} channels; each accelerometer has three")

    @property
    def block_samples(self) -> float:
        """Length of a block in samples: not always a whole number."""
        return self.conditioning.block_samples(self.sample_rate_hz)

    @property
    def samples_per_block(self) -> int:
        """Whole samples in one block at least: a chunk of this many completes one block at most."""
        return int(self.block_samples + ROUNDING)


def write_card(card: Card, path: Path) -> None:
    """Writes model.json. Infinite limits become null: JSON has no infinity."""
    table = {"format": FORMAT, "version": VERSION, **asdict(card)}
    table["units"] = {name: UNITS[name] for name in card.outputs}
    table["validity"] = {k: None if v == math.inf else v for k, v in table["validity"].items()}
    path.write_text(json.dumps(table, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_card(path: Path) -> Card:
    """Reads and validates model.json.

    Raises:
        InputError: the file is missing, no JSON, or of another format or version; a key is unknown or missing; a value
            is bad.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; a bundle holds model.onnx and model.json") from None
    except (ValueError, OSError) as error:
        raise InputError(f"{path}: not a model card ({error}); export the bundle again") from None
    if not isinstance(table, dict) or table.pop("format", None) != FORMAT:
        raise InputError(f"{path}: not a softslide model card; name a bundle that 'softslide train' made")
    if (version := table.pop("version", None)) != VERSION:
        raise InputError(
            f"{path}: card version {version}, this release reads {VERSION}; export the bundle again"
        )
    table.pop("units", None)
    if odd := sorted(set(table) ^ {f.name for f in fields(Card)}):
        raise InputError(f"{path}: key '{odd[0]}' is missing or unknown; export the bundle again")
    try:
        limits: dict[str, Any] = {k: math.inf if v is None else v for k, v in table["validity"].items()}
        limits["speed_mm_s"] = tuple(limits["speed_mm_s"])
        return Card(
            **{
                **table,
                "outputs": tuple(table["outputs"]),
                "channels": tuple(table["channels"]),
                "reference_mm": tuple(float(v) for v in table["reference_mm"]),
                "sample_rate_hz": float(table["sample_rate_hz"]),
                "conditioning": Conditioning(**table["conditioning"]),
                "intervals": {k: Interval(**v) for k, v in table["intervals"].items()},
                "validity": Validity(**limits),
            }
        )
    except (TypeError, ValueError, AttributeError, KeyError) as error:
        raise InputError(f"{path}: a value does not fit ({error}); export the bundle again") from None

"""The types and ranges of a model card's fields: what lies outside them would fail, or answer wrongly, later."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from softslide.features.names import check_plain
from softslide.features.stream.drift import measures_gravity

if TYPE_CHECKING:
    from softslide.features.card import Card

# Orders of magnitude beyond any sensor that is built; they bound the memory and the work of a stream.
MOST_ACCELEROMETERS = 64
HIGHEST_RATE_HZ = 1e6
MOST_MM = 1e4
MOST_VOLTS = 1e3
# Of anything else: times in s, speeds in mm/s, factors.
LARGEST = 1e6


def check_fields(card: "Card") -> None:
    """Checks every field that an answer depends on.

    Raises:
        ValueError: a field has another type, or its value lies outside its range.
    """
    check_plain(_text(card.model, "model"), "model")
    _text(card.graph_sha256, "graph_sha256")
    _number(card.sample_rate_hz, "sample_rate_hz", 0.0, HIGHEST_RATE_HZ, above=True)
    _numbers(card.reference_mm, "reference_mm", 2, -MOST_MM, MOST_MM)
    _sensor(card.sensor)
    names = tuple(f"a{n}_v{axis}" for n in range(len(card.sensor["accelerometers"])) for axis in "xyz")
    if card.channels != names:
        raise ValueError(
            f"channels are {', '.join(map(str, card.channels))}, the sensor's are {', '.join(names)}"
        )
    if card.samples_per_block < 1:
        raise ValueError(
            f"sample_rate_hz {card.sample_rate_hz:g} gives no sample in a block of {card.conditioning.block_s:g} s"
        )
    for name, interval in card.intervals.items():
        _number(interval.scale, f"intervals: {name}: scale", 0.0, LARGEST)
        _number(interval.floor, f"intervals: {name}: floor", 0.0, LARGEST)
    speeds = card.validity.speed_mm_s
    _numbers(speeds, "validity: speed_mm_s", 2, 0.0, LARGEST)
    if not 0 < speeds[0] <= speeds[1]:
        raise ValueError(f"validity: speed_mm_s is {list(speeds)}; it must be positive and rise")
    _number(card.validity.peak_v, "validity: peak_v", 0.0, MOST_VOLTS)
    for name in ("offset_mm", "misfit", "direction_sd_deg", "log_speed_sd"):
        if (limit := getattr(card.validity, name)) != math.inf:
            _number(limit, f"validity: {name}", 0.0, LARGEST)
    axes = len(card.conditioning.touch_axes)
    if card.contact is not None and 3 * len(card.contact.noise_v) != axes * len(card.channels):
        raise ValueError(
            f"contact: noise_v has {len(card.contact.noise_v)} channels, the card {len(card.channels)}"
        )
    if card.heights is not None:
        if card.contact is None or card.heights.knots != card.contact.knots:
            raise ValueError("heights: its map is not like the one of contact")
        card.heights.splines(len(card.contact.noise_v))
    _base(card)
    _table(card.provenance, "provenance")
    _golden(_table(card.golden, "golden"))


def _golden(golden: Mapping[str, Any]) -> None:
    """An estimator without a graph has no example; that a graph's fits its outputs is checked by working it."""
    if not golden:
        return
    if set(golden) != {"inputs", "estimate"}:
        raise ValueError("golden holds other keys than inputs and estimate")
    _table(golden["inputs"], "golden: inputs")
    estimate = golden["estimate"]
    count = len(estimate) if isinstance(estimate, list | tuple) else 1
    _numbers(estimate, "golden: estimate", count, -math.inf, math.inf)


def _sensor(sensor: Any) -> None:
    accelerometers = _table(sensor, "sensor").get("accelerometers")
    if not isinstance(accelerometers, list | tuple) or not 1 <= len(accelerometers) <= MOST_ACCELEROMETERS:
        raise ValueError(f"sensor: accelerometers is no list of 1 to {MOST_ACCELEROMETERS}")
    check_plain(_text(sensor.get("name"), "sensor: name"), "sensor: name")
    _numbers(sensor.get("chamber_mm"), "sensor: chamber_mm", 2, 0.0, MOST_MM)
    _number(sensor.get("indenter_diameter_mm", 0.0), "sensor: indenter_diameter_mm", 0.0, MOST_MM)
    _number(sensor.get("adc_step_v", 0.0), "sensor: adc_step_v", 0.0, LARGEST)
    for n, accelerometer in enumerate(accelerometers):
        place = f"sensor: accelerometer {n}"
        _table(accelerometer, place)
        for key in ("x_mm", "y_mm"):
            _number(accelerometer.get(key), f"{place}: {key}", -MOST_MM, MOST_MM)
        check_plain(_text(accelerometer.get("name", "a"), f"{place}: name"), f"{place}: name")
        _text(accelerometer.get("kind", "accelerometer"), f"{place}: kind")
        for key in ("zero_g_v", "sensitivity_v_per_g") if measures_gravity(accelerometer) else ():
            _number(accelerometer.get(key), f"{place}: {key}", 0.0, MOST_VOLTS, above=True)


def _base(card: "Card") -> None:
    if card.base is None:
        return
    channels = len(card.channels)
    if len(card.base.gains) != channels:
        raise ValueError(f"base: {len(card.base.gains)} rows of gains for {channels} channels")
    for row in card.base.gains:
        _numbers(row, "base: gains", 3, -LARGEST, LARGEST)
    _numbers(card.base.base_v, "base: base_v", 3, -MOST_VOLTS, MOST_VOLTS)
    _numbers(card.base.static_v, "base: static_v", channels, -LARGEST, LARGEST)
    _numbers(card.base.gravity_v, "base: gravity_v", channels, -MOST_VOLTS, MOST_VOLTS)
    base = _table(card.sensor.get("base"), "sensor: base")
    _number(base.get("zero_g_v"), "sensor: base: zero_g_v", 0.0, MOST_VOLTS, above=True)


def _number(value: Any, name: str, low: float, high: float, above: bool = False) -> None:
    """Checks a real number: in low..high. above: it must be more than `low`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise ValueError(f"{name} is no number")
    if not low <= value <= high or (above and value == low):
        raise ValueError(f"{name} is {value:g}; it must lie in {low:g}..{high:g}")


def _numbers(value: Any, name: str, count: int, low: float, high: float) -> None:
    """Checks so many real numbers, each in low..high."""
    if not isinstance(value, list | tuple) or len(value) != count:
        raise ValueError(f"{name} is no list of {count} numbers")
    for item in value:
        _number(item, name, low, high)


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} is no text")
    return value


def _table(value: Any, name: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} is no table")
    return value

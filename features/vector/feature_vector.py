"""The feature vector: every quantity of a window that a classical model reads, with its name, place and unit.

| suffix | unit |
|---|---|
| `_v` | volts |
| `_s` | seconds since the trigger, or between two moments |
| `_fraction` | of the window's length |
| `_widths` | of the energy's width in time; moments count from the energy's centre |
| `_share` | of `rms_v`: the shape of a slide without its strength (depth, gain) |
| `_cos`, `_sin` | of a bearing: the direction of (V_x, V_y) at an extreme, counted from the output that is extreme |
| none | a sign or a zone |
"""

from itertools import combinations

import numpy as np

from softslide.features.vector.arc import ARC_POINTS, arc_curve
from softslide.features.vector.energy import energy_clock, tilt_outputs
from softslide.features.vector.extrema import maximum, minimum, value_at
from softslide.features.vector.zones import first_and_last, signs, zone, zones_in_order

EXTREMES = ("vx_min", "vx_max", "vy_min", "vy_max")
# Pairs of extremes: times between them, times the speed, are distances along the slide.
_INTERVALS = tuple(combinations(range(len(EXTREMES)), 2))
_INTERVAL_NAMES = tuple(f"{EXTREMES[a]}_to_{EXTREMES[b]}" for a, b in _INTERVALS)
_ZONES = 3
# Windows computed at a time, so that intermediate arrays stay within the processor's cache.
_BATCH = 256


def feature_names(accelerometers: int) -> tuple[str, ...]:
    """Names of the features of windows of that many accelerometers, in the vector's order."""
    clock = (
        "elapsed_s",
        "energy_centre_s",
        "energy_centre_fraction",
        "energy_width_s",
        "energy_width_fraction",
    )
    return clock + tuple(f"a{k}_{name}" for k in range(accelerometers) for name in _names_of_one())


def feature_vector(volts: np.ndarray, elapsed_s: float) -> np.ndarray:
    """Features (F,) float64 of one window: volts (C, 64) V, C = 3 an accelerometer, elapsed_s s."""
    return feature_matrix(np.asarray(volts)[None], np.array([elapsed_s]))[0]


def feature_matrix(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
    """Features (B, F) float64 of volts (B, C, N) V and elapsed_s (B,) s, in `feature_names` order.

    Each row is computed from its window alone, in the same order of operations whatever the batch.

    Raises:
        ValueError: arrays of other shapes.
    """
    volts, elapsed_s = np.asarray(volts), np.asarray(elapsed_s, np.float64)
    if volts.ndim != 3 or volts.shape[1] % 3 or not volts.shape[1] or volts.shape[2] < 3:
        raise ValueError(f"volts has shape {volts.shape}; expected (windows, 3 an accelerometer, bins)")
    if elapsed_s.shape != volts.shape[:1]:
        raise ValueError(f"elapsed_s has shape {elapsed_s.shape}; expected ({len(volts)},)")
    rows = np.empty((len(volts), len(feature_names(volts.shape[1] // 3))))
    for begin in range(0, len(volts), _BATCH):
        part = slice(begin, begin + _BATCH)
        rows[part] = _features(np.asarray(volts[part], np.float64), elapsed_s[part])
    return rows


def _features(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
    centre, width = energy_clock(tilt_outputs(volts))
    clock = np.stack([elapsed_s, centre * elapsed_s, centre, width * elapsed_s, width], axis=-1)
    each = [
        _features_of_one(volts[:, 3 * k : 3 * k + 3], elapsed_s, centre, width)
        for k in range(volts.shape[1] // 3)
    ]
    return np.concatenate([clock, *each], axis=-1)


def _names_of_one() -> tuple[str, ...]:
    others = {"vx": ("vy", "vz"), "vy": ("vx", "vz")}
    return (
        "rms_v",
        *(f"{extreme}_v" for extreme in EXTREMES),
        *(f"{extreme}_fraction" for extreme in EXTREMES),
        *(f"{extreme}_s" for extreme in EXTREMES),
        *(f"{extreme}_widths" for extreme in EXTREMES),
        *(f"{other}_at_{extreme}_v" for extreme in EXTREMES for other in others[extreme[:2]]),
        *(f"{name}_s" for name in _INTERVAL_NAMES),
        *(f"{name}_widths" for name in _INTERVAL_NAMES),
        *(f"{output}_sign_{when}" for output in ("vx", "vy") for when in ("first", "last")),
        *(f"zone_{k}" for k in range(1, _ZONES + 1)),
        *(f"zone_{k}_fraction" for k in range(1, _ZONES + 1)),
        "arc_length_v",
        *(f"{output}_arc_{k:02d}_v" for output in ("vx", "vy") for k in range(ARC_POINTS)),
        *(f"{extreme}_share" for extreme in EXTREMES),
        *(f"{others[extreme[:2]][0]}_at_{extreme}_share" for extreme in EXTREMES),
        *(f"{output}_arc_{k:02d}_share" for output in ("vx", "vy") for k in range(ARC_POINTS)),
        *(f"{extreme}_bearing_{part}" for extreme in EXTREMES for part in ("cos", "sin")),
    )


def _features_of_one(
    volts: np.ndarray, elapsed_s: np.ndarray, centre: np.ndarray, width: np.ndarray
) -> np.ndarray:
    """(B, F1) in `_names_of_one` order: volts (B, 3, N) of one accelerometer; centre, width (B,) fractions."""
    tilt = volts[:, :2]
    rms = np.sqrt(np.square(tilt).sum(axis=1).mean(axis=-1, keepdims=True))
    unit = np.where(rms > 0, rms, 1.0)
    (low, low_at), (high, high_at) = minimum(tilt), maximum(tilt)
    # (B, 2 outputs, 2 extremes) -> (B, 4) in EXTREMES order.
    extremes = np.stack([low, high], axis=-1).reshape(-1, 4)
    moments = np.stack([low_at, high_at], axis=-1).reshape(-1, 4)
    # (B, 4 extremes, V_y or V_x and V_z), extremes of V_x first.
    others = np.stack(
        [
            np.stack([value_at(volts[:, c], moments[:, e]) for c in (1 - e // 2, 2)], axis=-1)
            for e in range(4)
        ],
        axis=1,
    )
    between = np.stack([moments[:, b] - moments[:, a] for a, b in _INTERVALS], axis=-1)
    sign = signs(tilt)
    zones, entered = zones_in_order(zone(sign), _ZONES)
    curve, length = arc_curve(tilt)
    points = curve.reshape(-1, 2 * ARC_POINTS)
    return np.concatenate(
        [
            rms,
            extremes,
            moments,
            moments * elapsed_s[:, None],
            (moments - centre[:, None]) / width[:, None],
            others.reshape(-1, 8),
            between * elapsed_s[:, None],
            between / width[:, None],
            np.stack(first_and_last(sign), axis=-1).reshape(-1, 4),
            zones,
            entered,
            length[:, None],
            points,
            extremes / unit,
            others[:, :, 0] / unit,
            points / unit,
            _bearings(extremes, others[:, :, 0]),
        ],
        axis=-1,
    )


def _bearings(extremes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """cos, sin (B, 8) of the angle of (extreme, other output at that moment), (B, 4) V each; (1, 0) without signal."""
    size = np.sqrt(np.square(extremes) + np.square(others))
    some = size > 0
    unit = np.where(some, size, 1.0)
    return np.stack([np.where(some, extremes / unit, 1.0), others / unit], axis=-1).reshape(len(extremes), -1)

"""The changes of a slide's signal that `changed_slides` reads, by name."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from softslide.pipeline.sensor import Sensor

SWAY_DEG, SWAY_S = 2.0, 5.0
LOST_SHARE, LOST_RUN = 0.05, 30  # of samples, in bursts
# Volts (n, C) V, the static output (C,) V, time (n,) s and the sensor to changed volts.
Change = Callable[[np.ndarray, np.ndarray, np.ndarray, Sensor], np.ndarray]


def _scaled(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, by: float) -> np.ndarray:
    return _first(v, static + by * (v - static))


def _gain(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, axis: int, by: float) -> np.ndarray:
    zero = s.accelerometers[0].zero_g_v
    return _with(v, axis, zero + by * (v[:, axis] - zero))


def _exchanged(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor) -> np.ndarray:
    return _with(_with(v, 0, v[:, 1]), 1, v[:, 0])


def _clipped(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, by_v: float) -> np.ndarray:
    return _first(v, np.clip(v, static - by_v, static + by_v))


def _wire(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, axes: Sequence[int]) -> np.ndarray:
    for axis in axes:
        v = _with(v, axis, np.zeros(len(v)))
    return v


def _mounted(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, deg: float) -> np.ndarray:
    return _turned(v, s, np.full(len(v), np.deg2rad(deg)))


def _swaying(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor) -> np.ndarray:
    return _turned(v, s, np.deg2rad(SWAY_DEG) * np.sin(2 * np.pi * t / SWAY_S))


def _turned(v: np.ndarray, s: Sensor, angle: np.ndarray) -> np.ndarray:
    """As a sensor that is turned about its x by angles (n,) rad reads gravity."""
    v, cos, sin = v.copy(), np.cos(angle), np.sin(angle)
    for k, part in enumerate(s.accelerometers):
        y, z = ((v[:, 3 * k + axis] - part.zero_g_v) for axis in (1, 2))
        v[:, 3 * k + 1], v[:, 3 * k + 2] = (
            part.zero_g_v + cos * y - sin * z,
            part.zero_g_v + sin * y + cos * z,
        )
    return v


def _supply(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, by: float) -> np.ndarray:
    return v * np.where(t > t[-1] / 2, by, 1.0)[:, None]


def _lost(v: np.ndarray, static: np.ndarray, t: np.ndarray, s: Sensor, as_v: float) -> np.ndarray:
    starts = np.random.default_rng(0).random(len(v)) < LOST_SHARE / LOST_RUN
    gone = np.convolve(starts, np.ones(LOST_RUN))[: len(v)] > 0
    return np.where(gone[:, None], as_v, v)


def _with(v: np.ndarray, axis: int, column: np.ndarray) -> np.ndarray:
    v = v.copy()
    v[:, axis] = column
    return v


def _first(v: np.ndarray, changed: np.ndarray) -> np.ndarray:
    return np.hstack([changed[:, :3], v[:, 3:]])


CHANGES: dict[str, Change] = {
    "none": lambda v, static, t, s: v,
    "zero + 50 mV": lambda v, static, t, s: v + 0.05,
    **{f"amplitude x {by:g}": partial(_scaled, by=by) for by in (0.5, 0.75, 0.9, 1.1, 1.3)},
    **{f"V_{'xyz'[n]} x {by:g}": partial(_gain, axis=n, by=by) for n, by in ((0, 0.7), (0, 0.9), (2, 0.7))},
    "x and y exchanged": _exchanged,
    **{f"V_{'xyz'[n]} mirrored": partial(_gain, axis=n, by=-1.0) for n in range(3)},
    **{f"clipped at {1000 * by:g} mV": partial(_clipped, by_v=by) for by in (0.02, 0.05)},
    **{f"mounted at {deg:g} deg": partial(_mounted, deg=deg) for deg in (3, 5, 10, 20, 60, 180)},
    **{f"V_{name} at 0 V": partial(_wire, axes=axes) for name, axes in (("x", [0]), ("z", [2]), ("xyz", [0, 1, 2]))},
    **{f"supply x {by:g} midway": partial(_supply, by=by) for by in (0.99, 0.95)},
    **{f"5 % lost, {name}": partial(_lost, as_v=as_v) for name, as_v in (("nan", np.nan), ("0 V", 0.0))},
    "swaying": _swaying,
}  # fmt: skip

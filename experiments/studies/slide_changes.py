"""The changes of a slide's signal that `changed_slides` reads, by name."""

from collections.abc import Callable, Sequence

import numpy as np

from softslide.pipeline.sensor import Sensor

LOST_SHARE, LOST_RUN = 0.05, 30  # of samples, in bursts
# One accelerometer's volts (n, 3) V, their static output (3,) V, time (n,) s and volts at 0 g to changed volts.
Change = Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]


def changed(
    name: str, volts: np.ndarray, static: np.ndarray, time_s: np.ndarray, sensor: Sensor
) -> np.ndarray:
    """A slide's volts (n, C) V with one of CHANGES in the first accelerometer, or in EACH. static: (C,) V at rest."""
    volts = volts.copy()
    parts = sensor.accelerometers if name.startswith(EACH) else sensor.accelerometers[:1]
    for k, part in enumerate(parts):
        own = slice(3 * k, 3 * k + 3)
        volts[:, own] = CHANGES[name](volts[:, own], static[own], time_s, part.zero_g_v)
    return volts


def _amplitude(by: float) -> Change:
    return lambda v, static, t, zero: static + by * (v - static)


def _gain(axis: int, by: float) -> Change:
    return lambda v, static, t, zero: np.where(np.arange(3) == axis, zero + by * (v - zero), v)


def _clipped(by_v: float) -> Change:
    return lambda v, static, t, zero: np.clip(v, static - by_v, static + by_v)


def _dead(axes: Sequence[int]) -> Change:
    return lambda v, static, t, zero: np.where(np.isin(np.arange(3), axes), 0.0, v)


def _supply(by: float) -> Change:
    return lambda v, static, t, zero: v * np.where(t > t[-1] / 2, by, 1.0)[:, None]


def _turned(deg: float, period_s: float | None = None) -> Change:
    """As a sensor reads gravity that is turned about its x by an angle, or sways by it."""

    def change(v: np.ndarray, static: np.ndarray, t: np.ndarray, zero: float) -> np.ndarray:
        angle = np.deg2rad(deg) * (1.0 if period_s is None else np.sin(2 * np.pi * t / period_s))
        cos, sin, (_, y, z) = np.cos(angle), np.sin(angle), (v - zero).T
        return np.column_stack([v[:, 0], zero + cos * y - sin * z, zero + sin * y + cos * z])

    return change


def _lost(as_v: float) -> Change:
    def change(v: np.ndarray, static: np.ndarray, t: np.ndarray, zero: float) -> np.ndarray:
        starts = np.random.default_rng(0).random(len(v)) < LOST_SHARE / LOST_RUN
        gone = np.convolve(starts, np.ones(LOST_RUN))[: len(v)] > 0
        return np.where(gone[:, None], as_v, v)

    return change


# How the names of those of every accelerometer begin.
EACH = ("zero", "mounted", "supply", "5 % lost", "swaying")
CHANGES: dict[str, Change] = {
    "none": lambda v, static, t, zero: v,
    "zero + 50 mV": lambda v, static, t, zero: v + 0.05,
    **{f"amplitude x {by:g}": _amplitude(by) for by in (0.5, 0.75, 0.9, 1.1, 1.3)},
    **{f"V_{'xyz'[n]} x {by:g}": _gain(n, by) for n, by in ((0, 0.7), (0, 0.9), (2, 0.7))},
    "x and y exchanged": lambda v, static, t, zero: v[:, [1, 0, 2]],
    **{f"V_{'xyz'[n]} mirrored": _gain(n, -1.0) for n in range(3)},
    **{f"clipped at {1000 * by:g} mV": _clipped(by) for by in (0.02, 0.05)},
    **{f"mounted at {deg:g} deg": _turned(deg) for deg in (3, 5, 10, 20, 60, 180)},
    **{f"V_{name} at 0 V": _dead(axes) for name, axes in (("x", [0]), ("z", [2]), ("xyz", [0, 1, 2]))},
    **{f"supply x {by:g} midway": _supply(by) for by in (0.99, 0.95)},
    **{f"5 % lost, {name}": _lost(as_v) for name, as_v in (("nan", np.nan), ("0 V", 0.0))},
    "swaying": _turned(2.0, period_s=5.0),
}

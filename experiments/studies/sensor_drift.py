"""Errors of a bundle on a sensor that has drifted: recordings with a drift added, and without."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.evaluation.scoring import signed_errors
from experiments.provenance import bundle_hash, data_tags
from experiments.tracking.study import tracked_study
from features.errors import InputError
from pipeline.recordings.folder import Folder, read_folder
from pipeline.sensor import Sensor
from serve.localizer import Localizer

Drift = Callable[[np.ndarray, np.ndarray, Sensor], tuple[np.ndarray, np.ndarray]]
ZERO_SHIFT_V = 0.05
GAIN = 1.05
TILT_DEG = 5.0
LOST = 0.05
LABELLED = ("direction_deg", "speed_mm_s", "offset_mm")


def clean(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """volts (n, C) V at times (n,) s, as they are."""
    return volts, time_s


def zero_shift(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Every channel's zero lies 50 mV higher."""
    return volts + ZERO_SHIFT_V, time_s


def gain(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Every channel's gain is 5 % higher, gravity included."""
    zero = _zero(sensor)
    return zero + GAIN * (volts - zero), time_s


def tilt(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """The sensor is mounted 5 degrees tilted, about the axis half way between its x and y."""
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    angle = np.deg2rad(TILT_DEG)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    zero = _zero(sensor)
    vectors = (volts - zero).reshape(len(volts), -1, 3)
    return zero + (vectors @ rotation.T).reshape(volts.shape), time_s


def lost(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """5 % of the samples never arrive; the others carry their times."""
    kept = np.random.default_rng(0).random(len(volts)) >= LOST
    return volts[kept], time_s[kept]


DRIFTS: dict[str, Drift] = {f.__name__: f for f in (clean, zero_shift, gain, tilt, lost)}


def errors(localizer: Localizer, folder: Folder, drift: Drift) -> Iterator[dict[str, float]]:
    """Each recording's absolute errors at its end, whether it is valid, and the drift that the runtime found."""
    for name, row in folder.manifest.iterrows():
        recording = folder.load(str(name))
        volts, time_s = drift(recording.volts, recording.time_s, folder.sensor)
        localizer.reset()
        localizer.feed(volts, time_s)
        told = localizer.read()
        table = pd.DataFrame([told._asdict() | {f"true_{label}": row[label] for label in LABELLED}])
        error = signed_errors(table).iloc[0]
        yield {
            "direction_deg": abs(error["direction_deg"]),
            "speed_percent": 100 * abs(np.expm1(error["log_speed"])),
            "offset_mm": abs(error["offset_mm"]),
            "valid": float(told.valid),
            "gain": told.gain,
            "turn_deg": told.turn_deg,
        }


def drift(
    bundle: Path, recordings: Path, every: int = 1, store: str | None = None
) -> dict[str, dict[str, float]]:
    """`study` of every n-th labelled recording of a folder's test splits, logged as a run with one below it a drift.

    store: as in `tracking.store.store_address`.

    Raises:
        InputError: the bundle or the folder is not valid, or the bundle reads a base; the folder has no such recording,
            or `every` is below 1.
    """
    if every < 1:
        raise InputError(f"{every}: take every first, second or later one", "every")
    folder = read_folder(recordings).select("test").labelled()
    if not len(folder):
        raise InputError(f"{recordings}: no labelled slide of a split test*; name another folder")
    folder = replace(folder, manifest=folder.manifest.iloc[::every])
    card = Localizer.load(bundle).card
    if card.base is not None:
        raise InputError(f"{bundle}: reads a base, of which drifts are not made; name a bundle without one")
    model = card.model
    configuration = {"bundle": str(bundle), "recordings": str(recordings), "every": every}
    tags = {"bundle": bundle_hash(bundle)} | data_tags(folder)
    name = f"drift of {model} on {folder.sensor.name}"
    with tracked_study("drift", name, configuration, Path("drift"), tags=tags, store=store) as (_, part):
        figures = study(bundle, folder)
        for label, found in figures.items():
            part(label, {"drift": label}, found)
    return figures


def study(bundle: Path, folder: Folder) -> dict[str, dict[str, float]]:
    """Each drift's mean figures; errors are those of the estimates marked valid."""
    localizer = Localizer.load(bundle)
    figures = {}
    for label, added in DRIFTS.items():
        rows = list(errors(localizer, folder, added))
        table = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        valid = table["valid"] > 0
        figures[label] = {
            key: float(np.mean(values if key == "valid" else values[valid])) for key, values in table.items()
        }
    return figures


def _zero(sensor: Sensor) -> np.ndarray:
    return np.repeat([board.zero_g_v for board in sensor.accelerometers], 3)

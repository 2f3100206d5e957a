"""How much a sensor's drift costs a bundle.

Reads the test splits as they are and with a drift added by calculation: zero shifted by 50 mV, gain up by 5 %, the
sensor tilted by 5 deg, 5 % of the samples lost. Prints for each the mean errors of the valid estimates at the end of
the recording in deg, % and mm, the share that is valid, and the gain and turn (deg) that the runtime found.

    python -m softslide.experiments.studies.sensor_drift --model my-model --recordings my-recordings
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.scoring import signed_errors
from softslide.experiments.studies.script import Part, bundle, count, parser, recordings, run
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.serve.localizer import Localizer

# Volts (n, C) V, times (n,) s and the channels' zeros (C,) V to drifted volts and times.
Drift = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
ZERO_SHIFT_V = 0.05
GAIN = 1.05
TILT_DEG = 5.0
LOST = 0.05
LABELS = ("direction_deg", "speed_mm_s", "offset_mm")


def tilted(volts: np.ndarray) -> np.ndarray:
    """Volts (n, C) V about the zeros, gravity in them, of a sensor that is turned by TILT_DEG about its axis x = y."""
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    angle = np.deg2rad(TILT_DEG)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return (volts.reshape(len(volts), -1, 3) @ rotation.T).reshape(volts.shape)


def lost(volts: np.ndarray, time_s: np.ndarray, zero_v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Samples that never arrive; the others carry their times."""
    arrived = np.random.default_rng(0).random(len(volts)) >= LOST
    return volts[arrived], time_s[arrived]


DRIFTS: dict[str, Drift] = {
    "clean": lambda volts, time_s, zero_v: (volts, time_s),
    "zero_shift": lambda volts, time_s, zero_v: (volts + ZERO_SHIFT_V, time_s),
    "gain": lambda volts, time_s, zero_v: (zero_v + GAIN * (volts - zero_v), time_s),
    "tilt": lambda volts, time_s, zero_v: (zero_v + tilted(volts - zero_v), time_s),
    "lost": lost,
}


def drift(bundle: Path, folder: Folder) -> Iterator[Part]:
    """Each drift's mean figures over the folder's recordings.

    Raises:
        InputError: the folder has no labelled recording; the bundle is not valid, or reads a base.
    """
    if not len(folder.labelled()):
        raise InputError(f"{folder.root}: no labelled slide of a split test*; name another folder")
    localizer = Localizer.load(bundle)
    if localizer.card.base is not None:
        raise InputError(f"{bundle}: reads a base, of which drifts are not made; name a bundle without one")
    for name, added in DRIFTS.items():
        table = pd.DataFrame([*errors(localizer, folder.labelled(), added)])
        yield name, {**table[table["valid"] > 0].mean(), "valid": float(table["valid"].mean())}


def errors(localizer: Localizer, folder: Folder, drift: Drift) -> Iterator[dict[str, float]]:
    """Each recording's absolute errors at its end, whether it is valid, and the drift that the runtime found."""
    zero_v = np.repeat([board.zero_g_v for board in folder.sensor.accelerometers], 3)
    for name, row in folder.manifest.iterrows():
        recording = folder.load(str(name))
        localizer.reset()
        localizer.feed(*drift(recording.volts, recording.time_s, zero_v))
        estimate = localizer.read()
        table = pd.DataFrame([estimate._asdict() | {f"true_{label}": row[label] for label in LABELS}])
        error = signed_errors(table).iloc[0]
        yield {
            "direction_deg": abs(error["direction_deg"]),
            "speed_percent": 100 * abs(np.expm1(error["log_speed"])),
            "offset_mm": abs(error["offset_mm"]),
            "valid": float(estimate.valid),
            "gain": estimate.gain,
            "turn_deg": estimate.turn_deg,
        }


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("sensor_drift", __doc__)
    bundle(words)
    recordings(words, "its test splits are read")
    count(words, "--every", 1, "every Nth")

    def study(given: argparse.Namespace) -> Iterator[Part]:
        folder = read_folder(given.recordings).select("test").labelled()
        return drift(given.model, replace(folder, manifest=folder.manifest.iloc[:: given.every]))

    return run(words, study, argv)


if __name__ == "__main__":
    sys.exit(main())

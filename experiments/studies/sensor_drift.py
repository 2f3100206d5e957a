"""How much worse a bundle gets on a device that has drifted: recordings with the drift put in, clean ones beside.

python -m experiments.studies.sensor_drift --model BUNDLE --recordings DIR [--every N]
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from features.errors import InputError
from pipeline.recordings.folder import Folder, read_folder
from pipeline.sensor import Sensor
from serve.localizer import Localizer

Injection = Callable[[np.ndarray, np.ndarray, Sensor], tuple[np.ndarray, np.ndarray]]
ZERO_SHIFT_V = 0.05
GAIN = 1.05
TURN_DEG = 5.0
LOST = 0.05


def clean(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """volts (n, C) V at times (n,) s, as they are."""
    return volts, time_s


def zero_shift(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Every channel's zero lies 50 mV higher."""
    return volts + ZERO_SHIFT_V, time_s


def gain(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """Every channel answers 5 % more to the same acceleration, gravity included."""
    zero = _zero(sensor)
    return zero + GAIN * (volts - zero), time_s


def turn(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """The device stands 5 degrees askew, about the middle between its x and y axes: gravity turns."""
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    angle = np.deg2rad(TURN_DEG)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    zero = _zero(sensor)
    vectors = (volts - zero).reshape(len(volts), -1, 3)
    return zero + (vectors @ rotation.T).reshape(volts.shape), time_s


def lost(volts: np.ndarray, time_s: np.ndarray, sensor: Sensor) -> tuple[np.ndarray, np.ndarray]:
    """5 % of the samples never arrive; the others carry their times."""
    kept = np.random.default_rng(0).random(len(volts)) >= LOST
    return volts[kept], time_s[kept]


INJECTIONS: dict[str, Injection] = {f.__name__: f for f in (clean, zero_shift, gain, turn, lost)}


def errors(localizer: Localizer, folder: Folder, inject: Injection) -> Iterator[dict[str, float]]:
    """One recording after the other: absolute errors at its end, whether valid, and what the device noticed."""
    for name, row in folder.manifest.iterrows():
        recording = folder.load(str(name))
        volts, time_s = inject(recording.volts, recording.time_s, folder.sensor)
        localizer.reset()
        localizer.feed(volts, time_s)
        told = localizer.read()
        yield {
            "direction_deg": abs((told.direction_deg - row["direction_deg"] + 180) % 360 - 180),
            "speed_percent": 100 * abs(told.speed_mm_s / row["speed_mm_s"] - 1),
            "offset_mm": abs(told.offset_mm - row["offset_mm"]),
            "valid": float(told.valid),
            "gain": told.gain,
            "turn_deg": told.turn_deg,
        }


def study(bundle: Path, folder: Folder) -> dict[str, dict[str, float]]:
    """Each injection's mean figures; errors are those of the estimates marked valid."""
    localizer = Localizer.load(bundle)
    figures = {}
    for label, inject in INJECTIONS.items():
        rows = list(errors(localizer, folder, inject))
        table = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        valid = table["valid"] > 0
        figures[label] = {
            key: float(np.mean(values if key == "valid" else values[valid])) for key, values in table.items()
        }
    return figures


def _zero(sensor: Sensor) -> np.ndarray:
    return np.repeat([board.zero_g_v for board in sensor.accelerometers], 3)


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the figures as one JSON object. Returns 0, or 2 on bad input."""
    parser = argparse.ArgumentParser(prog="python -m experiments.studies.sensor_drift", description=__doc__)
    parser.add_argument("--model", type=Path, required=True, metavar="BUNDLE")
    parser.add_argument(
        "--recordings", type=Path, required=True, metavar="DIR", help="its test splits are used"
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every Nth recording only")
    arguments = parser.parse_args(argv)
    try:
        if arguments.every < 1:
            raise InputError(f"--every {arguments.every}: take every first, second or later one")
        folder = read_folder(arguments.recordings).select("test").labelled()
        if not len(folder):
            raise InputError(
                f"{arguments.recordings}: no labelled slide of a split test*; name another folder"
            )
        some = Folder(folder.root, folder.sensor, folder.manifest.iloc[:: arguments.every])
        print(json.dumps(study(arguments.model, some), indent=1))
    except InputError as error:
        print(f"injection: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

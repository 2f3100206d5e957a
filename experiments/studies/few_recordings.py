"""How few recordings will do: the response map from so many calibration slides, inverted on every test slide.

python -m experiments.studies.few_recordings --recordings DIR [--slides 0 4 12 24 48] [--draws 3] [--split NAME ...]

No network is trained: the map is what recordings pay for, and its inversion by least squares (models/cnn/inversion.py)
shows what it is worth.
"""

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from features.errors import InputError
from models.cnn.fit import CnnConfig, signed_errors
from models.cnn.inversion import Inversion
from models.response_map.calibrate import calibration_slides
from models.response_map.lag import calibrated_device
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.library import atlas_of
from pipeline.recordings.folder import Folder, read_folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows


def study(
    folder: Folder, counts: Sequence[int], draws: int, splits: Sequence[str], atlas: Atlas
) -> Iterator[dict[str, float]]:
    """Mean and largest errors at the end of the stroke for each number of slides and each random draw of them.

    Raises:
        InputError: a number of slides or draws that is none, or no labelled slide of the splits.
    """
    if min(counts) < 0 or draws < 1:
        raise InputError(f"{min(counts)} slides in {draws} draws; take 0 or more in at least one")
    config = CnnConfig()
    taught = folder.select("calibration", "train").labelled()
    names = [slide.recording for slide in calibration_slides(taught, config.conditioning)]
    scored = folder.select(*splits).labelled()
    if not len(scored):
        raise InputError(f"{folder.root}: no labelled slide of a split {' or '.join(splits)}*; name another")
    for count in counts:
        for draw in range(draws if 0 < count < len(names) else 1):
            chosen = np.random.default_rng(draw).choice(len(names), min(count, len(names)), replace=False)
            part = replace(taught, manifest=taught.manifest.loc[[names[n] for n in np.sort(chosen)]])
            device = calibrated_device(part, atlas, config.conditioning, config.calibration, config.spread)
            windows = labelled_windows(scored, device.conditioning, (1.0,))
            inversion = Inversion(device.maps.response, device.conditioning.block_s)
            found = inversion.predict(windows.volts, windows.elapsed_s)
            yield {"slides": len(part), "draw": draw, **_errors(found, windows)}


def _errors(found: np.ndarray, windows: LabelledWindows) -> dict[str, float]:
    turn, speed, offset = signed_errors(found, windows)
    errors = {
        "direction_deg": np.abs(turn),
        "speed_percent": 100 * np.abs(np.expm1(speed)),
        "offset_mm": np.abs(offset),
    }
    return {
        f"{name}_{what}": round(float(of(values)), 4)
        for name, values in errors.items()
        for what, of in (("mean", np.mean), ("max", np.max))
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Prints one JSON object a draw. Returns 0, or 2 on bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.studies.few_recordings", description=__doc__.split("\n\n")[0]
    )
    parser.add_argument(
        "--recordings", type=Path, required=True, metavar="DIR", help="a folder of one sensor"
    )
    parser.add_argument(
        "--slides",
        type=int,
        nargs="+",
        default=[0, 4, 12, 24, 48],
        metavar="N",
        help="how many (default: %(default)s)",
    )
    parser.add_argument("--draws", type=int, default=3, metavar="N", help="of each (default: %(default)s)")
    parser.add_argument(
        "--split",
        nargs="+",
        default=["test"],
        metavar="NAME",
        help="beginnings of the splits scored (default: test)",
    )
    arguments = parser.parse_args(argv)
    try:
        folder = read_folder(arguments.recordings)
        atlas = atlas_of(folder.sensor)
        for row in study(folder, arguments.slides, arguments.draws, arguments.split, atlas):
            print(json.dumps(row), flush=True)
    except InputError as error:
        print(f"few: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""The calibrated map of a training, kept for the next training of the same recordings.

A file of the user's cache folder, named by a hash of all that the map depends on: recordings, atlas, settings, code,
the libraries that compute it and the processor.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from softslide.experiments.cached import Arrays, cached
from softslide.experiments.code_hash import code_hash
from softslide.experiments.provenance import data_hashes, machine
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.select import CalibratedMap, calibrated_map
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.models.response_map.slides import LABELS
from softslide.pipeline.atlas.atlas import Atlas, atlas_hash
from softslide.pipeline.atlas.library import cache_folder
from softslide.pipeline.recordings.folder import Folder

# Files of some 200 kB each.
MOST = 50
# What computes the map.
MAKER = "softslide.models.response_map.select"
LIBRARIES = ("numpy", "scipy")
# What a CalibratedMap holds as JSON takes it.
PLAIN = ("slides", "summary", "untimed", "left_out")


def kept_map(
    folder: Folder,
    atlas: Atlas | None,
    conditioning: Conditioning,
    calibration: CalibrationConfig,
    spread: SensorSpread,
    *,
    fresh: bool = False,
    taken: Callable[[Path], None] = lambda place: None,
) -> CalibratedMap:
    """`calibrated_map`, or what an earlier call kept of it; the same to the bit. fresh, taken: as in `cached`.

    Raises:
        InputError: as `calibrated_map`.
    """
    key = {
        "data": data_hashes(folder),
        "atlas": None if atlas is None else atlas_hash(atlas),
        "settings": [asdict(each) for each in (folder.sensor, conditioning, calibration, spread)],
        "code": code_hash([MAKER]),
        "libraries": {name: version(name) for name in LIBRARIES},
        "processor": machine()["processor"],
    }

    def make() -> Arrays:
        return _packed(calibrated_map(folder, atlas, conditioning, calibration, spread))

    arrays = cached(cache_folder() / "maps", key, make, most=MOST, fresh=fresh, taken=taken)
    # Kept or not, the map goes this way: arrays in another order of memory would be rounded otherwise later.
    return _unpacked(arrays, folder)


def _packed(found: CalibratedMap) -> Arrays:
    maps = [found.response, *(response for response, _ in found.held_out)]
    arrays = {f"unseen.{n}": names for n, (_, names) in enumerate(found.held_out)}
    numbers = []
    for n, response in enumerate(maps):
        values = {field.name: getattr(response, field.name) for field in fields(ResponseMap)}
        arrays |= {f"map.{n}.{k}": v for k, v in values.items() if isinstance(v, np.ndarray)}
        numbers.append({k: v for k, v in values.items() if not isinstance(v, np.ndarray)})
    rest = {name: getattr(found, name) for name in PLAIN} | {
        "maps": numbers,
        "conditioning": asdict(found.conditioning),
    }
    return {
        **{name: np.ascontiguousarray(values) for name, values in arrays.items()},
        "recordings": found.folder.manifest.index.to_numpy(str),
        "motion": found.folder.manifest[list(LABELS)].to_numpy(float),
        "rest": np.array(json.dumps(rest)),
    }


def _unpacked(arrays: Arrays, folder: Folder) -> CalibratedMap:
    """folder: the recordings to calibrate on; those that the map is of have the motion that was kept."""
    rest = json.loads(str(arrays["rest"]))
    maps = []
    for n, numbers in enumerate(rest["maps"]):
        own = {k.removeprefix(f"map.{n}."): v for k, v in arrays.items() if k.startswith(f"map.{n}.")}
        maps.append(ResponseMap(**(own | _tuples(numbers))))
    table = folder.manifest.loc[arrays["recordings"]]
    motion = dict(zip(LABELS, arrays["motion"].T, strict=True))
    return CalibratedMap(
        response=maps[0],
        held_out=[(response, arrays[f"unseen.{n}"]) for n, response in enumerate(maps[1:])],
        conditioning=Conditioning(**rest["conditioning"]),
        folder=replace(folder, manifest=table.assign(**motion)),
        **{name: rest[name] for name in PLAIN},
    )


def _tuples(table: dict[str, Any]) -> dict[str, Any]:
    """A table as JSON has it, with tuples for its lists."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}

"""Several folders of recordings of one sensor, read as one."""

import math
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder, read_folder

# Column of a pooled manifest, in no file: how much a recording counts.
WEIGHT = "derived.weight"
# What may differ between folders of one sensor.
OWN = ("name", "origin", "pressure_mpa", "mains_hz")


def read_folders(roots: Path | Sequence[Path], weights: Sequence[float] = ()) -> Folder:
    """The recordings of all folders, or of the one, with the first one's `sensor.toml`; its root is the first folder's.

    weights: how much each folder's recordings count in a calibration (column WEIGHT); none: all alike.

    Raises:
        InputError: a folder is not as docs/format.md says, is of another sensor than the first, or repeats the name of
            a recording; or the weights are not one above 0 for each.
    """
    roots = [roots] if isinstance(roots, Path) else roots
    if weights and (len(weights) != len(roots) or not all(0 < weight < math.inf for weight in weights)):
        raise InputError(
            f"{', '.join(f'{weight:g}' for weight in weights)} for {len(roots)} folders; name one above 0 for each",
            "weight",
        )
    folders = [read_folder(root) for root in roots]
    first = folders[0]
    for other in folders[1:]:
        _check_same_sensor(first, other)
    tables = [_seen_from(first.root, folder) for folder in folders]
    if weights:
        tables = [table.assign(**{WEIGHT: weight}) for table, weight in zip(tables, weights, strict=True)]
    manifest = pd.concat(tables)
    if (again := manifest.index.duplicated()).any():
        raise InputError(
            f"{manifest.index[again][0]}: a recording of this name is in several of the folders "
            f"{', '.join(str(root) for root in roots)}; name each differently"
        )
    return replace(first, manifest=manifest)


def _seen_from(root: Path, folder: Folder) -> pd.DataFrame:
    """The folder's manifest, its files named from `root`."""
    if folder.root == root:
        return folder.manifest
    way = os.path.relpath(folder.root, root)
    return folder.manifest.assign(file=[f"{way}/{file}" for file in folder.manifest["file"]])


def _check_same_sensor(first: Folder, other: Folder) -> None:
    mine, theirs = asdict(first.sensor), asdict(other.sensor)
    for key in mine:
        if key not in OWN and mine[key] != theirs[key]:
            raise InputError(
                f"{other.root / 'sensor.toml'}: {key} is {theirs[key]}, in {first.root} {mine[key]}; "
                "pool recordings of one sensor alone"
            )

"""One re-calibration: a bundle and a few recordings in, the bundle with renewed gains out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from softslide.experiments.derived_labels import derived
from softslide.experiments.provenance import data_hashes
from softslide.models.export.recalibrate import recalibrate
from softslide.pipeline.recordings.folder import read_folder


def recalibrate_bundle(
    bundle: Path, recordings: Path, splits: Sequence[str] | None, out: Path
) -> dict[str, Any]:
    """`models.export.recalibrate.recalibrate` with the recordings of some splits (None: all), their hashes kept.

    Raises:
        InputError: as there, or the folder is not valid.
    """
    folder = read_folder(recordings)
    if splits:
        folder = folder.select(*splits)
    folder = derived(folder)
    return recalibrate(bundle, folder, out, data_hashes(folder))

"""One re-calibration: a bundle and a few recordings in, the bundle with renewed gains out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from softslide.experiments.derived_labels import derived
from softslide.experiments.provenance import data_hashes
from softslide.models.export.recalibrate import recalibrated
from softslide.pipeline.recordings.folder import read_folder


def recalibrate(
    model: str | Path, recordings: str | Path, out: str | Path, split: Sequence[str] | None = None
) -> dict[str, Any]:
    """`models.export.recalibrate.recalibrated` with the recordings of some splits (None: all), their hashes kept.

    Raises:
        InputError: as there, or the folder is not valid.
    """
    folder = read_folder(recordings)
    if split:
        folder = folder.select(*split)
    folder = derived(folder)
    return recalibrated(Path(model), folder, Path(out), data_hashes(folder))

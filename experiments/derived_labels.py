"""What a manifest leaves out, as `train` derives it: from other labels, and the motion of slides from their signal."""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.onset import with_onsets
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.models.response_map.slides import LABELS as OF_A_SLIDE
from softslide.pipeline.atlas.library import atlas_at_hand
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.derived_labels import UNTIMED, with_derived_labels
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.manifest import LABELS
from softslide.pipeline.recordings.truth import truth_path


def derived(folder: Folder) -> Folder:
    """The folder with every label that follows from others or, of slides whose line is known, from the signal; says
    which.

    Raises:
        InputError: a recording cannot be read.
    """
    found = with_derived_labels(folder)
    straight = np.array(
        [not truth_path(folder.root / f).is_file() for f in found.manifest["file"]], dtype=bool
    )
    slides = replace(found, manifest=found.manifest[straight]).labelled()
    if slides.manifest[list(OF_A_SLIDE)].isna().any(axis=None):
        found = replace(found, manifest=_placed(found.manifest, folder, slides))
    _say(folder.manifest, found.manifest)
    return found


def _placed(manifest: pd.DataFrame, folder: Folder, slides: Folder) -> pd.DataFrame:
    """The manifest with start and moments of the slides whose motion the signal shows."""
    try:
        slides = replace(slides, base_motion=folder.base_motion or without_base_motion(folder).base_motion)
    except InputError:
        return manifest  # of a robot that moves, of which nothing is known
    conditioning = conditioning_for(slides, Conditioning())
    atlas = atlas_at_hand(slides.sensor)
    found, _ = with_onsets(slides, atlas, conditioning, SensorSpread(), CalibrationConfig())
    table, columns = manifest.assign(**{UNTIMED: False}), [*LABELS, UNTIMED]
    table.loc[found.manifest.index, columns] = found.manifest[columns]
    return table


def _say(before: pd.DataFrame, after: pd.DataFrame) -> None:
    filled = (before[list(LABELS)].isna() & after[list(LABELS)].notna()).sum()
    if filled.any():
        each = ", ".join(f"{label} of {count}" for label, count in filled[filled > 0].items())
        print(f"derived from other labels and the signal, as 'train' does: {each}", file=sys.stderr)

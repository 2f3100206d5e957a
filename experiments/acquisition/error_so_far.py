"""How far off estimates still are while a plan is recorded: each slide is scored by the map of those before it.

No error is of a slide that its map has seen (prequential validation: A. P. Dawid 1984).
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.scoring import QUANTITIES, WORDS
from softslide.experiments.kept_map import kept_map
from softslide.features.errors import InputError
from softslide.models.cnn.fit import CnnConfig
from softslide.models.cnn.inversion import Inversion
from softslide.models.held_out import signed_errors
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.pipeline.sensor import Sensor

# Slides that the first map is calibrated on, and the newest ones that an error is the mean of (experiments/LOG.md).
FIRST, NEWEST = 6, 8
COLUMNS = {QUANTITIES[name]: name for name in WORDS}


def read_goal(words: Sequence[str]) -> dict[str, float]:
    """Errors to reach, "0.3deg", "0.7%", "0.09mm", by the column of `errors`.

    Raises:
        InputError: one is not a positive number and a unit.
    """
    goal = {}
    for word in words:
        found = re.fullmatch(r"(\d+\.?\d*|\.\d+)(deg|%|mm)", word)
        if not found or float(found[1]) == 0.0:
            raise InputError(f"{word}: give an error to reach, as 0.3deg, 0.7% or 0.09mm", "until")
        goal[COLUMNS[found[2]]] = float(found[1])
    return goal


def atlas_to_calibrate(sensor: Sensor) -> Atlas | None:
    """The design's atlas; None of other elements than accelerometers, whose maps come from recordings alone."""
    return atlas_of(sensor) if sensor.measures_gravity else None


def errors(part: Folder, scored: Folder, atlas: Atlas | None) -> pd.DataFrame:
    """Of the map calibrated on `part`: absolute errors of a row for each slide `scored`, deg, % and mm."""
    config = CnnConfig()
    conditioning = conditioning_for(part, config.conditioning)
    found = kept_map(part, atlas, conditioning, config.calibration, config.spread)
    windows = labelled_windows(scored, found.conditioning, (1.0,))
    inversion = Inversion(found.response, found.conditioning.block_s)
    rows = inversion.predict(windows.volts, windows.elapsed_s)
    signed = signed_errors(rows, inversion.outputs, windows)
    return pd.DataFrame(
        {
            "direction_deg": np.abs(signed["direction_deg"]),
            "speed_percent": 100 * np.abs(np.expm1(signed["log_speed"])),
            "offset_mm": np.abs(signed["offset_mm"]),
        },
        index=windows.recording,
    )


class ErrorSoFar:
    """The errors of a growing folder's slides, each by the map of those before. rows: by recording, as `errors`.

    atlas: of the folder's design, as `atlas_to_calibrate` gives it.
    """

    def __init__(self, atlas: Atlas | None) -> None:
        self._atlas = atlas
        self.rows = pd.DataFrame(columns=list(COLUMNS.values()), dtype=float)

    def newest(self, folder: Folder) -> pd.DataFrame:
        """Errors of the NEWEST slides to learn from, fewer at first, in the order in which they were recorded.

        Raises:
            InputError: a slide cannot be read, or no map be calibrated.
        """
        learned = recordings_to_learn_from(folder)
        names = [str(name) for name in learned.manifest.index]
        for place in range(max(FIRST, len(names) - NEWEST), len(names)):
            if names[place] not in self.rows.index:
                before, this = (
                    replace(learned, manifest=learned.manifest.loc[some])
                    for some in (names[:place], names[place : place + 1])
                )
                self.rows.loc[names[place]] = errors(before, this, self._atlas).iloc[0]
        return self.rows.loc[[name for name in names[-NEWEST:] if name in self.rows.index]]

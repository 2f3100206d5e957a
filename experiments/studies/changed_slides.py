"""Slides whose signal is not what the bundle was calibrated with: does it abstain, or do its intervals hold?

Changes the volts of test slides: zero, amplitude, one gain, axes exchanged or mirrored, clipped, mounted at another
angle, dead wires, supply, lost samples, no rest before, sways. Prints for each change the share (%) of estimates from
half of the stroke on that are valid, of these the share (%) whose 90 % intervals of direction, speed and offset hold,
and their mean errors (deg, %, mm). With several accelerometers the first is changed, but for zero, angle, supply and
samples.

    python -m softslide.experiments.studies.changed_slides --model my-model --recordings my-recordings
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.readout import open_localizer, rows_of
from softslide.experiments.evaluation.scoring import INTERVALS, coverage, score
from softslide.experiments.studies.script import Part, bundle, count, parser, recordings, run
from softslide.experiments.studies.slide_changes import CHANGES, changed
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder, Recording, read_folder
from softslide.pipeline.workers import results

FROM = 0.5  # of the stroke
BEGINS = 0.3  # of the stroke, where there is no rest before
LATE = "begins in mid-slide"
ERRORS = ("direction_deg", "speed_percent", "offset_mm")


def changed_slides(bundle: Path, folder: Folder, every: int, jobs: int) -> Iterator[Part]:
    """For each change, over every so many of the folder's test slides, what this file's head says.

    Raises:
        InputError: the folder has no test slide with its moments of motion; the bundle is not valid, or reads a base.
    """
    if open_localizer(bundle).card.base is not None:
        raise InputError(f"{bundle}: reads a base, which is not changed here; name a bundle without one")
    chosen = folder.select("test").labelled()
    known = chosen.manifest[["motion_start_s", "motion_end_s"]].notna().all(axis=1)
    chosen = replace(chosen, manifest=chosen.manifest[known].iloc[::every])
    if not len(chosen):
        raise InputError(f"{folder.root}: no test slide has its moments of motion; name another folder")
    for name in (*CHANGES, LATE):
        calls = ((bundle, chosen, str(recording), name) for recording in chosen.manifest.index)
        table = pd.concat([pd.DataFrame(rows) for rows in results(_read, calls, jobs)], ignore_index=True)
        scored = score(table, chosen.manifest, chosen.sensor)
        scored = scored[scored["stroke_fraction"] >= FROM]
        held = coverage(scored)
        shares = {
            f"{column.split('_')[0]}_holds": 100 * held[column].get("share", np.nan) for column in INTERVALS
        }
        errors = {error: scored[f"{error}_error"].mean() for error in ERRORS}
        yield name, {"valid": 100 * scored["valid"].mean(), **shares, **errors}


def _read(bundle: Path, folder: Folder, name: str, change: str) -> list[dict]:
    recording, label = folder.load(name), folder.manifest.loc[name].to_dict()
    volts, time_s = recording.volts, recording.time_s
    static = volts[time_s < label["motion_start_s"]].mean(axis=0)
    if change == LATE:
        late = time_s >= BEGINS * label["motion_end_s"] + (1 - BEGINS) * label["motion_start_s"]
        volts, time_s = volts[late], time_s[late]
    else:
        volts = changed(change, volts, static, time_s, folder.sensor)
    return rows_of(open_localizer(bundle), Recording(name, time_s, volts), volts, label)


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("changed_slides", __doc__)
    bundle(words)
    recordings(words, "of the bundle's sensor, with test slides")
    count(words, "--every", 1, "of so many test slides one is read")
    count(words, "--jobs", 2, "slides that are read at a time")
    return run(words, lambda g: changed_slides(g.model, read_folder(g.recordings), g.every, g.jobs), argv)


if __name__ == "__main__":
    sys.exit(main())

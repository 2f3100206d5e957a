"""How few calibration recordings will do.

Calibrates the response map with so many of the calibration slides, drawn at random or named by a plan, and inverts it
by least squares (models/cnn/inversion.py) on every slide of the test splits; no network is trained. Prints, for each
number of slides, errors at the end of the stroke in deg, % and mm: means, over the draws, and the largest.

    python -m softslide.experiments.studies.few_recordings --recordings my-recordings --slides 4 12
    python -m softslide.experiments.studies.few_recordings --recordings my-recordings --plan plan.csv
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.acquisition.error_so_far import atlas_to_calibrate, errors
from softslide.experiments.studies.script import Part, count, parser, recordings, run
from softslide.features.errors import InputError
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.recordings.manifest import read_table


def few(
    folder: Folder, slides: Sequence[int], draws: int, splits: Sequence[str], plan: Path | None = None
) -> Iterator[Part]:
    """For each number of slides, or for the plan's: errors by quantity, and the largest as QUANTITY_max.

    splits: beginnings of the names of those to score. plan: a CSV whose recordings are used in place of random ones.

    Raises:
        InputError: no labelled slide to score, or the plan names no recording or one that is not a calibration slide.
    """
    learned = recordings_to_learn_from(folder)
    scored = folder.select(*splits).labelled()
    if not len(scored):
        raise InputError(f"{folder.root}: no labelled slide of a split {' or '.join(splits)}*; name another")
    atlas = atlas_to_calibrate(folder.sensor)
    if plan is None:
        chosen = _drawn(list(learned.manifest.index), slides, draws)
    else:
        names = sorted(planned(plan, learned))
        chosen = iter([(f"{len(names)}-planned", [names])])
    for label, choices in chosen:
        parts = [replace(learned, manifest=learned.manifest.loc[choice]) for choice in choices]
        tables = [errors(part, scored, atlas) for part in parts]
        means = pd.DataFrame([table.mean() for table in tables]).mean()
        yield label, {**means, **pd.concat(tables).max().add_suffix("_max")}


def _drawn(names: list[str], slides: Sequence[int], draws: int) -> Iterator[tuple[str, list[list[str]]]]:
    for size in (min(each, len(names)) for each in slides):
        seeds = range(draws if 0 < size < len(names) else 1)
        picks = [np.random.default_rng(seed).choice(len(names), size, replace=False) for seed in seeds]
        yield str(size), [[names[n] for n in np.sort(pick)] for pick in picks]


def planned(plan: Path, learned: Folder) -> list[str]:
    """The recordings that a plan names, in its order.

    Raises:
        InputError: it names none, or one that is not a calibration slide.
    """
    names = [str(name) for name in read_table(plan).get("recording", pd.Series(dtype=str))]
    unknown = [name for name in names if name not in learned.manifest.index]
    if unknown or not names:
        fault = f"'{unknown[0]}' is not a calibration slide" if unknown else "names no recording"
        raise InputError(f"{plan}: {fault}; plan it from the manifest of {learned.root}")
    return names


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("few_recordings", __doc__)
    recordings(words, "a folder of one sensor")
    count(words, "--slides", [0, 4, 12, 24, 48], least=0, nargs="+")
    count(words, "--draws", 3)
    words.add_argument("--plan", type=Path, metavar="plan.csv", help="from 'softslide plan --candidates'")
    what = "beginnings of what to score"
    words.add_argument("--split", nargs="+", default=["test"], metavar="NAME", help=what)

    def study(given: argparse.Namespace) -> Iterator[Part]:
        folder = without_base_motion(read_folder(given.recordings))
        return few(folder, given.slides, given.draws, given.split, given.plan)

    return run(words, study, argv)


if __name__ == "__main__":
    sys.exit(main())

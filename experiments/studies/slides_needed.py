"""How many slides a goal takes, in a plan's order and at random; and where `softslide record --until` would stop.

Walks through calibration slides in the plan's order and in orders drawn: after each slide the map is calibrated on
those so far. Prints, for each order, from how many slides on the errors of held-out calibration slides, which no order
holds, are in the mean no more than the goal, after how many `--until` stops, and the errors there, or with all slides
(deg, %, mm); of the orders drawn, the share that reaches the goal and the medians of those errors.

    softslide plan --sensor my-recordings/sensor.toml --candidates my-recordings/manifest.csv --slides 24 --out plan.csv
    python -m softslide.experiments.studies.slides_needed --recordings my-recordings --plan plan.csv
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from softslide.experiments.acquisition.error_so_far import (
    COLUMNS,
    FIRST,
    NEWEST,
    atlas_to_calibrate,
    errors,
    read_goal,
)
from softslide.experiments.studies.few_recordings import planned
from softslide.experiments.studies.script import Part, count, parser, recordings, run
from softslide.features.errors import InputError
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.workers import results


def needed(given: argparse.Namespace) -> Iterator[Part]:
    """The parts printed: of the plan, of each order drawn, and of those drawn together."""
    learned = recordings_to_learn_from(without_base_motion(read_folder(given.recordings)))
    goal = read_goal(given.until)
    order = planned(given.plan, learned)
    rest = [str(name) for name in learned.manifest.index if name not in order]
    if len(rest) < given.held_out:
        raise InputError(f"{len(rest)} slides are not of the plan; hold out fewer", "held_out")
    held_out = list(np.random.default_rng(0).choice(rest, given.held_out, replace=False))
    names = [str(name) for name in learned.manifest.index if name not in held_out]
    drawn = [
        list(np.random.default_rng(seed).permutation(names)[: len(order)]) for seed in range(given.draws)
    ]
    numbers = range(FIRST, len(order) + 1)
    calls = [(learned, each, number, held_out) for each in (order, *drawn) for number in numbers]
    steps, found = results(after, calls, given.jobs), list[dict[str, float]]()
    for name in ("plan", *(f"random-{seed}" for seed in range(given.draws))):
        walked = pd.DataFrame([next(steps) for _ in numbers], numbers)
        found.append(summary(walked, goal))
        yield name, found[-1]
    random = pd.DataFrame(found[1:], columns=list(found[0]))
    yield "random", {"reached": random["needed"].notna().mean(), **random[list(COLUMNS.values())].median()}


def after(learned: Folder, order: Sequence[str], number: int, held_out: Sequence[str]) -> dict[str, float]:
    """With the map of so many slides: mean errors of the held-out ones, and as next_* those of the slide after."""
    atlas = atlas_to_calibrate(learned.sensor)
    part, others = (
        replace(learned, manifest=learned.manifest.loc[list(some)])
        for some in (order[:number], [*held_out, *order[number : number + 1]])
    )
    found = errors(part, others, atlas)
    following = found[found.index.isin(order)].mean().add_prefix("next_")
    return {**found[found.index.isin(held_out)].mean(), **following}


def summary(walked: pd.DataFrame, goal: dict[str, float]) -> dict[str, float]:
    """needed, stops: numbers of slides, NaN where all were not enough; errors: of the held-out slides at the stop."""
    asked = pd.Series(goal)
    good = (walked[asked.index] <= asked).all(axis=1)
    # For good: with no more slides it is not missed again.
    lasting = good[::-1].cummin()[::-1]
    newest = walked[[f"next_{name}" for name in asked.index]].rolling(NEWEST).mean().shift()
    stop = walked.index[np.all(newest.to_numpy() <= asked.to_numpy(), axis=1).tolist()]
    stops = float(stop[0]) if len(stop) else np.nan
    at = walked.loc[stop[0] if len(stop) else walked.index[-1], list(COLUMNS.values())]
    return {"needed": float(walked.index[lasting][0]) if lasting.any() else np.nan, "stops": stops, **at}


def main(argv: Sequence[str] | None = None) -> int:
    """The study."""
    words = parser("slides_needed", __doc__)
    recordings(words, "a folder of one sensor")
    words.add_argument("--plan", type=Path, required=True, metavar="plan.csv", help="its order is walked too")
    goal = ["0.4deg", "0.7%", "0.09mm"]
    words.add_argument("--until", nargs="+", default=goal, metavar="ERROR", help="as of 'record'")
    count(words, "--draws", 10, "orders drawn")
    count(words, "--held-out", 40, "slides that errors are of")
    count(words, "--jobs", 2, "orders at once")
    return run(words, needed, argv)


if __name__ == "__main__":
    sys.exit(main())

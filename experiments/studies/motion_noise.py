"""Motion noises and manoeuvres of the contact tracker, by likelihood on paths.

A setting is worth the logarithm of the odds that the tracker's hypotheses gain over signals that need no response map,
summed over a path, the mean over the kinds of path, in nats. Each number is multiplied and divided by --factor in turn,
and what is better by --least is kept. Fit on synthetic paths of a sensor drawn anew (softslide synthesize --paths), of
which a bundle is trained; judge on another sensor with --rounds 0. What is fitted on synthetic paths alone is too sure
of itself on the emulated bench (experiments/LOG.md). A round of 80 paths takes half an hour of two cores.

    python -m softslide.experiments.studies.motion_noise --model my-model --recordings my-paths --jobs 2
    python -m softslide.experiments.studies.motion_noise --model other-model --recordings other-paths --rounds 0
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from softslide.experiments.studies.script import Part, bundle, count, parser, recordings, run
from softslide.features.card import Card, read_card
from softslide.features.contact.tracker import ContactTracker
from softslide.features.contact.tracking_config import TrackingConfig
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import LagUndone, block_means
from softslide.features.stream.tracker import SlideState, SlideTracker
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.workers import results

Blocks = list[tuple[np.ndarray, bool]]


def blocks_of(volts: np.ndarray, card: Card) -> Blocks:
    """What the tracker is pushed: subtracted outputs (C,) V with the lag undone, and whether something touches."""
    conditioning = card.conditioning
    stream = SlideTracker(conditioning, len(card.channels))
    lag = LagUndone(conditioning, len(stream.touch))
    pushed = []
    for block in block_means(volts, conditioning, card.sample_rate_hz):
        stream.push(conditioning.scale * block)
        if stream.known.all():
            touched = stream.state is SlideState.SLIDE
            pushed.append((lag.push(stream.subtracted[stream.touch]), touched))
    return pushed


def gained(blocks: Blocks, card: Card, config: TrackingConfig) -> float:
    """The logarithm of the odds that one path's hypotheses gain."""
    assert card.contact is not None
    tracker = ContactTracker(card.contact.surface(), card.contact, card.conditioning, config)
    total, every = 0.0, np.ones(len(blocks[0][0]), dtype=bool)
    for volts, touched in blocks:
        tracker.push(volts, touched, every)
        total += tracker.gained
    return total


def numbers(config: TrackingConfig) -> Iterator[tuple[str, str]]:
    """Part of the configuration and name of each number that is fitted."""
    for part in ("noise", "manoeuvres"):
        for field in fields(getattr(config, part)):
            if isinstance(getattr(getattr(config, part), field.name), float):
                yield part, field.name


def motion_noise(
    card: Card, folder: Folder, rounds: int, factor: float, least: float, jobs: int
) -> Iterator[Part]:
    """The gain of each kind of path as the numbers are, then each number that was kept with the mean gain."""
    paths = folder.manifest.index[folder.manifest["split"] != "track-press"]
    kinds = folder.manifest.loc[paths, "split"]
    blocks = [blocks_of(folder.load(str(name)).volts, card) for name in paths]
    if not all(blocks):
        raise InputError(f"{folder.root}: a path has no rest before its contact; name another folder")

    def worth(config: TrackingConfig) -> dict[str, float]:
        each = np.array(list(results(gained, [(path, card, config) for path in blocks], jobs)))
        of_kinds = {str(kind): float(each[kinds == kind].mean()) for kind in kinds.unique()}
        return of_kinds | {"mean": float(np.mean(list(of_kinds.values())))}

    config = TrackingConfig()
    found = worth(config)
    best = found["mean"]
    yield "as they are", found
    for _ in range(rounds):
        for part, name in numbers(config):
            for value in (getattr(getattr(config, part), name) * by for by in (factor, 1.0 / factor)):
                tried = replace(config, **{part: replace(getattr(config, part), **{name: value})})
                if (reached := worth(tried)["mean"]) > best + least:
                    config, best = tried, reached
                    yield f"{part}: {name} {value:.4g}", best


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("motion_noise", __doc__)
    bundle(words)
    recordings(words, "paths of its sensor, from 'softslide synthesize --paths'")
    count(words, "--rounds", 1, "through all numbers; 0: what they are worth as they are", least=0)
    words.add_argument("--factor", type=float, default=2.0, help="(default: %(default)s)")
    words.add_argument("--least", type=float, default=0.1, help="nats (default: %(default)s)")
    count(words, "--jobs", 1, "processes")

    def study(given: argparse.Namespace) -> Iterator[Part]:
        card = read_card(Path(given.model) / "model.json")
        if card.contact is None:
            raise InputError(f"{given.model}: tracks no contacts; name a cnn")
        folder = read_folder(given.recordings)
        return motion_noise(card, folder, given.rounds, given.factor, given.least, given.jobs)

    return run(words, study, argv)


if __name__ == "__main__":
    sys.exit(main())

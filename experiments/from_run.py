"""Trains again what a run of the store logged, and compares the bundle with the one made then."""

import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from softslide.experiments.configuration import read_configuration
from softslide.experiments.data_use import some
from softslide.experiments.flattened import flattened
from softslide.experiments.provenance import code_revision, data_hashes, machine, packages
from softslide.experiments.tracking import logged_run
from softslide.experiments.train import BUNDLE_FILES, to_learn_from, train
from softslide.features.errors import InputError
from softslide.models.registry import model_named
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.pooled import read_folders
from softslide.pipeline.toml_tables import changed

SHOWN = 6  # names in a line


def train_from_run(
    identifier: str, out: Path, recordings: Sequence[Path] = (), store: str | None = None
) -> dict[str, str]:
    """Trains with the recordings and settings of a run; how each of the bundle's files differs from the one made then.

    Says on standard error what is not as it was: recordings, code, packages, computer. A file that is the same to the
    byte gives an empty text. identifier: the run's in the store. recordings: where they are now; none: where they were.
    out: where the bundle goes. store: as in `tracking.store_address`.

    Raises:
        InputError: no such run, or not a training that has finished; or what it read is gone.
    """
    with tempfile.TemporaryDirectory() as scratch:
        files = Path(scratch) / "logged"
        tags = logged_run(identifier, files, store)
        configuration = read_configuration(files / "configuration.json")
        if configuration.get("command") != "train" or not (files / "bundle" / BUNDLE_FILES[0]).is_file():
            raise InputError(f"run {identifier}: not a training that has finished; name one")
        were = configuration["recordings"]
        source = list(recordings) or [Path(root) for root in ([were] if isinstance(were, str) else were)]
        for what in _not_as_it_was(tags, files, configuration, source):
            print(f"not as it was: {what}", file=sys.stderr)
        train(
            source,
            out,
            configuration["model"],
            weight=configuration["weights"],
            atlas=configuration["atlas"],
            init=configuration["init"],
            change=lambda default: changed(default, configuration["settings"], f"run {identifier}"),
            design_alone=configuration["design_alone"],
            fresh=True,
            store=store,
        )
        return {name: difference(files / "bundle" / name, out / name) for name in BUNDLE_FILES}


def difference(then: Path, now: Path) -> str:
    """How two files differ; empty where they are the same to the byte. Of JSON, the keys whose values differ."""
    before, after = then.read_bytes(), now.read_bytes()
    if before == after:
        return ""
    if then.suffix != ".json":
        return "differs"
    names = _differing(flattened(json.loads(before)), flattened(json.loads(after)))
    return f"differs in {some(names, SHOWN)}" if names else "differs in its layout"


def _differing(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    return [name for name in {**then, **now} if then.get(name) != now.get(name)]


def _changes(then: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """What each value was that differs, and what it is now."""
    return [
        f"{name} {then.get(name, 'absent')}, now {now.get(name, 'absent')}" for name in _differing(then, now)
    ]


def _not_as_it_was(
    tags: dict[str, str], files: Path, configuration: dict[str, Any], source: Sequence[Path]
) -> Iterator[str]:
    """What the run was made from and is different now. tags, files: of the run."""
    whole = without_base_motion(read_folders(source, configuration["weights"]))
    folder = to_learn_from(whole, model_named(configuration["model"]), configuration["design_alone"])
    for name, digest in data_hashes(folder).items():
        if tags.get(f"data.{name}") != digest:
            yield f"the recordings' {name}"
    yield from _changes({"code": tags.get("code")}, {"code": code_revision()})
    environment = (files / "environment.txt").read_text(encoding="utf-8")
    then, installed = (dict(line.split("==") for line in text.split()) for text in (environment, packages()))
    if changes := _changes(then, installed):
        yield some(changes, SHOWN)
    yield from _changes(json.loads((files / "machine.json").read_text(encoding="utf-8")), machine())

"""Repeats a run from what it logged, and compares what comes out with what came out then."""

import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.configuration import read_configuration
from experiments.evaluate import evaluate, to_score
from experiments.provenance import code_revision, data_hashes, machine, packages
from experiments.tracking.run import flattened
from experiments.tracking.store import LoggedRun, logged_run
from experiments.train import to_learn_from, train
from features.errors import InputError
from pipeline.recordings.base_motion import without_base_motion
from pipeline.recordings.folder import Folder
from pipeline.recordings.pooled import read_folders
from pipeline.toml_tables import changed

SHOWN = 6  # names in a line


@dataclass(frozen=True)
class _Kind:
    """What a command's run is repeated with. files: what it made, in the run's folder `made`. data: the recordings that
    it read, of a folder. again: runs it from its configuration and its recordings to a new folder: (run, configuration,
    recordings, folder)."""

    made: str
    files: tuple[str, ...]
    data: Callable[[Folder, dict[str, Any]], Folder]
    again: Callable[..., object]


def repeat(
    identifier: str, recordings: Path | None = None, out: Path | None = None, store: str | None = None
) -> dict[str, str]:
    """Runs a training or an evaluation again, unlogged; how each file that it made differs from the one made then.

    Says on standard error what is not as it was: recordings, code, packages, computer. A file that is the same to the
    byte gives an empty text. identifier: the run's in the store. recordings: where they are now; None: where they were.
    out: where the result goes; None: it is not kept. store: as in `store_address`.

    Raises:
        InputError: no such run, one that cannot be repeated, or what it read is gone.
    """
    with tempfile.TemporaryDirectory() as scratch:
        run = logged_run(identifier, Path(scratch) / "logged", store)
        configuration = read_configuration(run.files / "configuration.json")
        if (command := configuration.get("command")) not in KINDS:
            raise InputError(f"run {identifier}: of '{command}'; name one of {' or '.join(KINDS)}")
        kind = KINDS[command]
        if missing := [name for name in kind.files if not (run.files / kind.made / name).is_file()]:
            raise InputError(f"run {identifier}: it holds no {missing[0]}; name a run that has finished")
        were = configuration["recordings"]
        source = recordings or (Path(were) if isinstance(were, str) else [Path(root) for root in were])
        for line in _not_as_it_was(
            run, data_hashes(kind.data(read_folders(source, configuration.get("weights", ())), configuration))
        ):
            print(line, file=sys.stderr)
        made = out or Path(scratch) / "made"
        kind.again(run, configuration, source, made)
        return {name: difference(run.files / kind.made / name, made / name) for name in kind.files}


def difference(then: Path, now: Path) -> str:
    """How two files differ; empty where they are the same to the byte. Of JSON, the keys whose values differ."""
    before, after = then.read_bytes(), now.read_bytes()
    if before == after:
        return ""
    if then.suffix == ".json":
        a, b = flattened(json.loads(before)), flattened(json.loads(after))
        names = [name for name in {**a, **b} if a.get(name) != b.get(name)]
        return f"differs in {_some(names)}" if names else "differs in its layout"
    if then.suffix == ".csv":
        rows, now_rows = before.splitlines(), after.splitlines()
        count = sum(x != y for x, y in zip(rows, now_rows, strict=False)) + abs(len(rows) - len(now_rows))
        return f"differs in {count} of {len(rows)} rows"
    return "differs"


def _not_as_it_was(run: LoggedRun, hashes: dict[str, str]) -> Iterator[str]:
    """What the run was made from and is different now, a line each."""
    for name, digest in hashes.items():
        if run.tags.get(f"data.{name}") != digest:
            yield f"not as it was: the recordings' {name}"
    if (now := code_revision()) != run.tags.get("code"):
        yield f"not as it was: code {run.tags.get('code')}, now {now}"
    then, now_installed = (
        dict(line.split("==") for line in text.split())
        for text in ((run.files / "environment.txt").read_text(encoding="utf-8"), packages())
    )
    if names := [name for name in {**then, **now_installed} if then.get(name) != now_installed.get(name)]:
        told = [
            f"{name} {then.get(name, 'absent')}, now {now_installed.get(name, 'absent')}" for name in names
        ]
        yield f"not as it was: {_some(told)}"
    here = machine()
    for name, value in json.loads((run.files / "machine.json").read_text(encoding="utf-8")).items():
        if here.get(name) != value:
            yield f"not as it was: {name} {value}, now {here.get(name)}"


def _train_again(
    run: LoggedRun, configuration: dict[str, Any], recordings: Path | Sequence[Path], out: Path
) -> None:
    settings, place = configuration["settings"], f"run {run.identifier}"
    train(
        recordings,
        out,
        configuration["model"],
        weights=configuration.get("weights", ()),
        atlas=_path(configuration["atlas"]),
        init=_path(configuration["init"]),
        change=lambda default: changed(default, settings, place),
        design_alone=configuration["design_alone"],
        fresh=True,
        track=False,
    )


def _evaluate_again(run: LoggedRun, configuration: dict[str, Any], recordings: Path, out: Path) -> None:
    # A report names the bundle by its folder.
    bundle = run.files / Path(configuration["bundle"]).name
    (run.files / "bundle").rename(bundle)
    evaluate(bundle, recordings, configuration["splits"], out, track=False)


KINDS = {
    "train": _Kind(
        "bundle",
        ("model.onnx", "model.json"),
        lambda folder, configuration: to_learn_from(
            without_base_motion(folder), configuration["model"], configuration["design_alone"]
        ),
        _train_again,
    ),
    "evaluate": _Kind(
        "evaluation",
        ("predictions.csv", "metrics.json"),
        lambda folder, configuration: to_score(folder, configuration["splits"]),
        _evaluate_again,
    ),
}


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text)


def _some(names: list[str]) -> str:
    return ", ".join(names[:SHOWN]) + (", ..." if len(names) > SHOWN else "")

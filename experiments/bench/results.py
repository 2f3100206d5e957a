"""Figures of the documents: which are stale, and measuring these anew.

    python -m experiments.bench.results --stale
    python -m experiments.bench.results --renew --recordings-root recordings --work work
    python -m experiments.bench.results --evaluated bench-a=results-a

Works on docs/results.json and, whatever else it does, writes the tables of README.md and docs/results.md from it.
"""

import argparse
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.bench.documents import (
    hash_of,
    keys_of,
    outdated,
    read_results,
    read_tables,
    rewrite,
    take,
    take_evaluation,
    write_results,
)
from experiments.code_hash import ROOT
from features.errors import InputError

# Names of the article's variants in the figures (experiments/article/method.py).
METHODS = {
    "as published": "published",
    "at its best": "best",
    "v = a / t + b, t from the edge": "way-over-time",
}


def run(command: str, folder: Path) -> None:
    """Runs `softslide ...` or `python -m ...` in a folder. That a bound is not met, exit status 1, is not a failure.

    Raises:
        InputError: it failed.
    """
    print(command, file=sys.stderr)
    words = shlex.split(command.replace("softslide ", "python -m softslide ", 1))
    start = words.index("python")
    variables = dict(word.split("=") for word in words[:start])
    done = subprocess.run(
        [sys.executable, *words[start + 1 :]],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        check=False,
    )
    if done.returncode not in (0, int("evaluate" in words)):
        raise InputError(f"'{command}' failed with status {done.returncode}; mend it, then renew again")


def work_in(folder: Path, recordings: Path | None) -> None:
    """Puts links to the folders of recordings and to docs into an empty folder to run commands in.

    Raises:
        InputError: the folder holds something, from an earlier run for instance.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise InputError(f"{folder}: is not empty; name another folder with --work")
    for place in [ROOT / "docs", *(recordings.iterdir() if recordings else ())]:
        (folder / place.name).symlink_to(place.resolve())


def renew(results: dict[str, Any], name: str, folder: Path, ran: set[str], tables: dict[str, str]) -> None:
    """Runs those of a source's commands that have not run in the folder, and takes its figures.

    Raises:
        InputError: a command failed, or gave other figures than the tables show.
    """
    source = results[name]
    # Of the code that runs, should it be edited meanwhile.
    before = hash_of(source)
    for command in source["commands"]:
        if command not in ran:
            run(command, folder)
            ran.add(command)
    take_from(results, name, folder, tables)
    source["hash"] = before


def take_from(results: dict[str, Any], name: str, folder: Path, tables: dict[str, str]) -> None:
    """Takes the figures of a source that its commands have left in the folder."""
    commands = results[name]["commands"]
    if "softslide evaluate" in commands[-1]:
        take_evaluation(results, name, folder / _option(commands[-1], "--out"), tables)
    elif "softslide article" in commands[-1]:
        _take_article(results, name, folder)
    else:
        for command in commands:
            if "--json" in command:
                take(results, name, json.loads((folder / _option(command, "--json")).read_text()))


def is_taken(source: Mapping[str, Any]) -> bool:
    """Whether `take_from` knows where the figures are; others are entered by hand."""
    last = source["commands"][-1]
    return any(word in last for word in ("softslide evaluate", "softslide article", "--json"))


def _take_article(results: dict[str, Any], name: str, folder: Path) -> None:
    """Of one folder its figures; of several the least and the largest of each."""
    commands = [each for each in results[name]["commands"] if "softslide article" in each]
    every = pd.DataFrame([_variants(folder / _option(each, "--out") / "variants.csv") for each in commands])
    found = every.iloc[0] if len(every) == 1 else every.agg(["min", "max"])
    take(results, name, {str(key): figures for key, figures in found.to_dict().items()})


def _variants(path: Path) -> dict[str, float]:
    table = pd.read_csv(path)
    table = table[(table["least_speed_mm_s"] == 0) & table["variant"].isin(METHODS)].set_index("variant")
    return {
        f"{METHODS[str(variant)]}/{key}": row[key]
        for variant, row in table.iterrows()
        for key in table.columns.drop("least_speed_mm_s")
    }


def _option(command: str, name: str) -> str:
    words = shlex.split(command)
    return words[words.index(name) + 1]


def _by_hand(name: str, source: dict[str, Any], tables: dict[str, str]) -> str:
    keys = ", ".join(keys_of(name, tables.values()))
    steps = "; ".join(source["commands"])
    return f"{name}: run {steps}; enter {keys} in results.json; then --entered {name}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m experiments.bench.results",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--stale", action="store_true", help="list the sources of earlier code; status 1 if one has no mark"
    )
    parser.add_argument(
        "--mark", metavar="REASON", help="mark the sources of earlier code that have no mark as stale"
    )
    parser.add_argument(
        "--evaluated", nargs="+", default=[], metavar="SOURCE=DIR", help="take the figures of evaluations"
    )
    parser.add_argument(
        "--entered",
        nargs="+",
        default=[],
        metavar="SOURCE",
        help="figures were entered by hand, measured today with this code",
    )
    parser.add_argument(
        "--renew",
        nargs="*",
        metavar="SOURCE",
        help="run the commands of these sources, and take their figures (default: of all that are stale)",
    )
    parser.add_argument("--work", type=Path, metavar="DIR", help="an empty folder, where they run")
    parser.add_argument(
        "--recordings-root",
        type=Path,
        metavar="DIR",
        help="holds bench-a, bench-d and paths-a (default: none)",
    )
    parser.add_argument("--results", type=Path, default=ROOT / "docs" / "results.json", help="the figures")
    parser.add_argument(
        "--documents",
        nargs="*",
        type=Path,
        default=[ROOT / "README.md", ROOT / "docs" / "results.md"],
        metavar="FILE",
        help="whose tables are written (default: README.md and docs/results.md)",
    )
    return parser


def _run(given: argparse.Namespace) -> int:
    results = read_results(given.results)
    tables = read_tables(given.results.with_name("tables.toml"))
    old = outdated(results)
    if given.stale:
        for name in results:
            if why := results[name].get("stale", "not marked" if name in old else None):
                print(f"{name}: {results[name]['date']}: {why}")
        return int(any("stale" not in results[name] for name in old))
    evaluated = dict(word.partition("=")[::2] for word in given.evaluated)
    names = given.renew or [name for name in results if name in old or "stale" in results[name]]
    for name in (*evaluated, *given.entered, *(given.renew or ())):
        if name not in results:
            raise InputError(f"{name}: no such source; known are {', '.join(results)}")
    if given.mark:
        for name in old:
            results[name].setdefault("stale", given.mark)
    for name, folder in evaluated.items():
        take_evaluation(results, name, Path(folder), tables)
    for name in given.entered:
        take(results, name, {})
    if given.renew is not None:
        if given.work is None:
            raise InputError("--renew runs commands; name an empty folder for them with --work")
        work_in(given.work, given.recordings_root)
        ran: set[str] = set()
        for name in names:
            if is_taken(results[name]):
                renew(results, name, given.work, ran, tables)
            else:
                print(_by_hand(name, results[name], tables))
            write_results(given.results, results)
    if given.mark or evaluated or given.entered:
        write_results(given.results, results)
    for document in given.documents:
        changed = rewrite(document, results, tables)
        print(f"{document}: {'rewritten' if changed else 'as it was'}")
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """Does what is asked; 2 where the input is wrong."""
    try:
        return _run(_parser().parse_args(argv))
    except InputError as error:
        print(f"results: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
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


@dataclass
class Bench:
    """Where commands run, and what those that ran have printed: what several sources share is done once."""

    folder: Path
    printed: dict[str, str] = field(default_factory=dict)

    def run(self, command: str) -> None:
        """Runs `softslide ...`, as a shell would. That a bound is not met, exit status 1, is no failure.

        Raises:
            InputError: it failed.
        """
        if command in self.printed:
            return
        print(command, file=sys.stderr)
        words = shlex.split(command)
        start = words.index("softslide")
        done = subprocess.run(
            [sys.executable, "-m", *words[start:]],
            cwd=self.folder,
            env={**os.environ, "PYTHONPATH": str(ROOT), **dict(word.split("=") for word in words[:start])},
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        if done.returncode not in (0, 1 if words[start + 1] == "evaluate" else 0):
            raise InputError(f"'{command}' failed with status {done.returncode}; mend it, then renew again")
        self.printed[command] = done.stdout


def bench_at(folder: Path, recordings: Path | None) -> Bench:
    """An empty folder to run commands in, with links to the folders of recordings and to docs.

    Raises:
        InputError: the folder holds something, from an earlier run for instance.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise InputError(f"{folder}: is not empty; name another folder with --work")
    for place in [ROOT / "docs", *(recordings.iterdir() if recordings else ())]:
        (folder / place.name).symlink_to(place.resolve())
    return Bench(folder)


def renew(results: dict[str, Any], name: str, bench: Bench, tables: dict[str, str]) -> bool:
    """Runs a source's commands and takes its figures; whether they can be taken without a person.

    Raises:
        InputError: a command failed, or gave other figures than the tables show.
    """
    source = results[name]
    commands = source["commands"]
    job = shlex.split(commands[-1].partition("softslide ")[2])[:1]
    if not job or job[0] not in TAKEN:
        return False
    # Of the code that runs, should it be edited meanwhile.
    before = hash_of(source)
    for command in commands:
        bench.run(command)
    TAKEN[job[0]](results, name, bench, tables)
    source["hash"] = before
    return True


def _take_evaluation(results: dict[str, Any], name: str, bench: Bench, tables: dict[str, str]) -> None:
    take_evaluation(results, name, bench.folder / _out(results[name]["commands"][-1]), tables)


def _take_article(results: dict[str, Any], name: str, bench: Bench, tables: dict[str, str]) -> None:
    """Of one folder its figures; of several the least and the largest of each."""
    commands = [each for each in results[name]["commands"] if "softslide article" in each]
    every = pd.DataFrame([_variants(bench.folder / _out(each) / "variants.csv") for each in commands])
    if len(every) == 1:
        take(results, name, {str(key): float(values.iloc[0]) for key, values in every.items()})
    else:
        ranges = {
            str(key): {"min": float(values.min()), "max": float(values.max())}
            for key, values in every.items()
        }
        take(results, name, ranges)


def _variants(path: Path) -> dict[str, float]:
    table = pd.read_csv(path)
    table = table[(table["least_speed_mm_s"] == 0) & table["variant"].isin(METHODS)].set_index("variant")
    return {
        f"{METHODS[str(variant)]}/{key}": row[key]
        for variant, row in table.iterrows()
        for key in table.columns.drop("least_speed_mm_s")
    }


def _take_few(results: dict[str, Any], name: str, bench: Bench, tables: dict[str, str]) -> None:
    """Mean errors, over the draws where these are random."""
    printed = [bench.printed[each] for each in results[name]["commands"] if "softslide few" in each]
    rows = pd.DataFrame([json.loads(line) for text in printed for line in text.splitlines()])
    rows["kind"] = rows["slides"].astype(str) + rows["draw"].isna().map({True: "-planned", False: ""})
    means = rows.groupby("kind").mean(numeric_only=True).filter(like="_mean")
    take(
        results,
        name,
        {
            f"{kind}/{str(key).removesuffix('_mean')}": float(values[kind])
            for key, values in means.items()
            for kind in means.index
        },
    )


def _take_printed(results: dict[str, Any], name: str, bench: Bench, tables: dict[str, str]) -> None:
    take(results, name, json.loads(bench.printed[results[name]["commands"][-1]].splitlines()[-1]))


# How the figures of a source are taken, by the job of its last command.
TAKEN: dict[str, Callable[[dict[str, Any], str, Bench, dict[str, str]], None]] = {
    "evaluate": _take_evaluation,
    "article": _take_article,
    "few": _take_few,
    "bench": _take_printed,
}


def _out(command: str) -> str:
    words = shlex.split(command)
    return words[words.index("--out") + 1]


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
        bench = bench_at(given.work, given.recordings_root)
        for name in names:
            if not renew(results, name, bench, tables):
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

"""Tables of README.md and docs/results.md, written from one file of figures, and measuring these anew.

    python -m softslide.experiments.bench --stale
    python -m softslide.experiments.bench --renew --recordings-root recordings --work work

`docs/results.json` holds the figures by source, each source with the commands that make it, the day they were run, the
code that they depend on and its hash on that day; `docs/tables.toml` the tables as Markdown with a place for each
figure, `{source/key:format}`. A document marks where a table stands: `<!-- table: NAME -->`, the table, `<!-- end of
table -->`. A format is a number of significant digits, `.2f` and its like, or `%` for a share times a hundred. A source
that is marked as stale, with the reason, has a line that says so below each table that shows it.
"""

import argparse
import datetime
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from softslide.experiments.code_hash import ROOT, code_hash
from softslide.experiments.flattened import flattened
from softslide.experiments.pages.page import number
from softslide.features.errors import InputError
from softslide.pipeline.toml_tables import read_toml

RESULTS = ROOT / "docs" / "results.json"
DOCUMENTS = (ROOT / "README.md", ROOT / "docs" / "results.md")
PLACE = re.compile(r"\{([^{}/]+)/([^{}:]+):([^{}]+)\}")
BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
# Significant digits that are kept of a figure: more than any table shows.
DIGITS = 5
# The last of a source's commands that leave its figures in files; others are entered by hand.
LEAVING = ("softslide evaluate", "softslide article", "--json")
# Names of the article's variants in the figures (experiments/article/method.py).
METHODS = {
    "as published": "published",
    "at its best": "best",
    "v = a / t + b, t from the edge": "way-over-time",
}
Results = dict[str, Any]


def read_results(path: Path) -> Results:
    """The sources by name, each with `commands`, `date`, `figures`, `code` (as `code_hash` takes it) and its `hash`.

    A source may have `stale`: why its figures are of earlier code.

    Raises:
        InputError: there is no such file, or it holds something else.
    """
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
        for source in results.values():
            _ = [source[key] for key in ("commands", "date", "code", "hash")], source["figures"].items()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path}: holds no sources with commands, date, code, hash and figures; see docs/results.json"
        ) from None
    return results


def read_tables(path: Path) -> dict[str, str]:
    """Each table's Markdown by name; a line with `@` stands for one a word of its `each`."""

    def lines(table: Mapping[str, Any]) -> Iterator[str]:
        for line in table["rows"].splitlines(keepends=True):
            for word in table.get("each", ()) if "@" in line else ("",):
                yield line.replace("@", word)

    return {name: "".join(lines(table)) for name, table in read_toml(path).items()}


def rewrite(document: Path, results: Results, tables: Mapping[str, str]) -> bool:
    """Writes the document's tables anew; whether it has changed.

    Raises:
        InputError: it cannot be read, or marks a table or a figure that there is not.
    """
    try:
        before = document.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{document}: cannot be read ({error.strerror})") from None

    def block(found: re.Match[str]) -> str:
        if found[2] not in tables:
            raise InputError(f"{document}: no table '{found[2]}'; known are {', '.join(tables)}")
        return found[1] + filled(tables[found[2]], results) + found[4]

    # Before anything is written: a table that is not closed would take the text down to the next one's end with it.
    if before.count("<!-- table: ") != len(BLOCK.findall(before)):
        raise InputError(f"{document}: a table is not closed; write '<!-- end of table -->' below it")
    after = BLOCK.sub(block, before)
    document.write_text(after, encoding="utf-8")
    return after != before


def filled(table: str, results: Results) -> str:
    """The table with every figure in its place, and a line for each stale source below it.

    Raises:
        InputError: a figure is missing.
    """

    def figure(found: re.Match[str]) -> str:
        source, key, form = found.groups()
        try:
            value = results[source]["figures"][key]
        except KeyError:
            raise InputError(
                f"no figure '{key}' of '{source}'; measure it, or take it out of the tables"
            ) from None
        if form == "%":
            return f"{100 * value:.0f}"
        return number(value, int(form)) if form.isdigit() else format(value, form)

    text = PLACE.sub(figure, table)
    for name in dict.fromkeys(name for name, _, _ in PLACE.findall(table)):
        if why := results[name].get("stale"):
            day = results[name]["date"]
            text += f"\n*`{name}`: measured with an earlier version of the code ({day}): {why}.*\n"
    return text


def keys_of(source: str, tables: Mapping[str, str]) -> list[str]:
    """The figures of a source that tables show, each once."""
    places = PLACE.findall("".join(tables.values()))
    return list(dict.fromkeys(key for name, key, _ in places if name == source))


def hash_of(source: Mapping[str, Any]) -> str:
    """The present code of a source, as its `hash`."""
    return code_hash(source["code"])[:16]


def outdated(results: Results) -> list[str]:
    """The sources that were measured with other code than the present one."""
    return [name for name, source in results.items() if source["hash"] != hash_of(source)]


def take(source: dict[str, Any], figures: Mapping[str, Any], code: str) -> None:
    """Puts new figures of a source in place of its old ones, with today's date: it is no longer stale.

    figures: numbers, or tables of them, whose keys are joined by `/`. code: hash of what measured them.
    """
    source.pop("stale", None)
    source |= {"hash": code, "date": datetime.datetime.now(datetime.UTC).date().isoformat()}
    for key, value in _numbers(figures).items():
        if value is None:
            # What could not be measured this time is not what it was.
            source["figures"].pop(key, None)
        else:
            source["figures"][key] = float(f"{value:.{DIGITS}g}")


def figures_in(folder: Path, name: str, commands: Sequence[str], tables: Mapping[str, str]) -> dict[str, Any]:
    """The figures of a source that its commands have left in the folder.

    Raises:
        InputError: a figure that tables show is missing.
    """

    def left(command: str, option: str = "--out") -> Path:
        words = shlex.split(command)
        return folder / words[words.index(option) + 1]

    if "softslide evaluate" in commands[-1]:
        metrics = json.loads((left(commands[-1]) / "metrics.json").read_text(encoding="utf-8"))
        metrics["bounds"] = {bound["name"]: bound for bound in metrics["bounds"]}
        found, wanted = _numbers(metrics), keys_of(name, tables)
        if missing := [key for key in wanted if found.get(key) is None]:
            raise InputError(f"{name}: its evaluation holds no {missing[0]}")
        return {key: found[key] for key in wanted}
    if "softslide article" in commands[-1]:
        places = [left(command) / "variants.csv" for command in commands if "softslide article" in command]
        every = pd.DataFrame([_variants(place) for place in places])
        # Of several seeds the least and the largest of each.
        seeds = every.iloc[0] if len(every) == 1 else every.agg(["min", "max"])
        return {str(key): figures for key, figures in seeds.to_dict().items()}
    reports = [left(command, "--json") for command in commands if "--json" in command]
    return {key: value for path in reports for key, value in _numbers(json.loads(path.read_text())).items()}


def _variants(path: Path) -> dict[str, float]:
    table = pd.read_csv(path)
    table = table[(table["least_speed_mm_s"] == 0) & table["variant"].isin(METHODS)].set_index("variant")
    rows = table.drop(columns="least_speed_mm_s").to_dict("index")
    return {f"{METHODS[str(name)]}/{key}": value for name, row in rows.items() for key, value in row.items()}


def _numbers(values: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of nested tables, with the way to each; None: not known."""
    kinds = int | float | None
    flat = flattened(values, "/").items()
    return {key: value for key, value in flat if isinstance(value, kinds) and not isinstance(value, bool)}


def run(command: str, folder: Path) -> None:
    """Runs `softslide ...` or `python -m ...` in a folder. That a bound is not met, exit status 1, is not a failure.

    Raises:
        InputError: it failed.
    """
    print(command, file=sys.stderr)
    words = shlex.split(command.replace("softslide ", "python -m softslide ", 1))
    start = words.index("python")
    variables = {"PYTHONPATH": str(ROOT), **dict(word.split("=") for word in words[:start])}
    words = [sys.executable, *words[start + 1 :]]
    done = subprocess.run(words, cwd=folder, env=os.environ | variables, check=False)
    if done.returncode not in (0, int("evaluate" in words)):
        raise InputError(f"'{command}' failed with status {done.returncode}; mend it, then renew again")


def renew(
    results: Results, names: Sequence[str], given: argparse.Namespace, tables: Mapping[str, str]
) -> Iterator[str]:
    """Runs the commands of sources, each once, in an empty folder with links to the recordings and to docs, and takes
    their figures; the names of those taken, as they come.

    Raises:
        InputError: the folder holds something, a command failed, or gave other figures than the tables show.
    """
    if given.work is None:
        raise InputError("--renew runs commands; name an empty folder for them with --work")
    given.work.mkdir(parents=True, exist_ok=True)
    if any(given.work.iterdir()):
        raise InputError(f"{given.work}: is not empty; name another folder with --work")
    root = given.recordings_root
    for place in [ROOT / "docs", *(root.iterdir() if root else ())]:
        (given.work / place.name).symlink_to(place.resolve())
    ran: set[str] = set()
    for name in names:
        # Of the code that runs, should it be edited meanwhile.
        source, code = results[name], hash_of(results[name])
        if not any(word in source["commands"][-1] for word in LEAVING):
            keys, steps = ", ".join(keys_of(name, tables)), "; ".join(source["commands"])
            print(f"{name}: run {steps}; enter {keys} in results.json; then --entered {name}")
            continue
        for command in source["commands"]:
            if command not in ran:
                run(command, given.work)
                ran.add(command)
        take(source, figures_in(given.work, name, source["commands"], tables), code)
        yield name


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m softslide.experiments.bench",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("--stale", action="store_true", help="list the sources of earlier code; status 1 if one has no mark")
    add("--mark", metavar="REASON", help="mark the sources of earlier code that have no mark as stale")
    add("--entered", nargs="+", default=[], metavar="SOURCE", help="their figures were entered by hand today")
    add("--renew", nargs="*", metavar="SOURCE", help="measure them anew (default: all that are stale)")
    add("--work", type=Path, metavar="DIR", help="an empty folder, where the commands run")
    add(
        "--recordings-root",
        type=Path,
        metavar="DIR",
        help="holds bench-a, bench-d, bench-depth and paths-a (default: none)",
    )
    return parser


def _do(given: argparse.Namespace, path: Path, documents: Sequence[Path]) -> int:
    results, tables = read_results(path), read_tables(path.with_name("tables.toml"))
    old = outdated(results)
    if given.stale:
        why = {name: s.get("stale", "not marked" if name in old else "") for name, s in results.items()}
        for name in filter(why.get, results):
            print(f"{name}: {results[name]['date']}: {why[name]}")
        return int("not marked" in why.values())
    if unknown := [name for name in (*given.entered, *(given.renew or ())) if name not in results]:
        raise InputError(f"{unknown[0]}: no such source; known are {', '.join(results)}")
    for name in old if given.mark else ():
        results[name].setdefault("stale", given.mark)
    for name in given.entered:
        take(results[name], {}, hash_of(results[name]))
    stale = [name for name in results if name in old or "stale" in results[name]]
    renewed = () if given.renew is None else renew(results, given.renew or stale, given, tables)
    # After each source: a later command may fail.
    for _ in chain([""], renewed):
        path.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for document in documents:
        print(f"{document}: {'rewritten' if rewrite(document, results, tables) else 'as it was'}")
    return 0


def main(
    argv: Sequence[str] | None = None, path: Path = RESULTS, documents: Sequence[Path] = DOCUMENTS
) -> int:
    """Does what is asked, then writes the tables; 2 where the input is wrong."""
    try:
        return _do(_parser().parse_args(argv), path, documents)
    except InputError as error:
        print(f"bench: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

"""Tables of README.md and docs/results.md, written from one file of figures.

`docs/results.json` holds the figures by source, each source with the commands that make it, the day they were run, the
code that they depend on and its hash on that day; `docs/tables.toml` the tables as Markdown with a place for each
figure, `{source/key:format}`. A document marks where a table stands: `<!-- table: NAME -->`, the table, `<!-- end of
table -->`. A format is a number of significant digits, `.2f` and its like, or `%` for a share times a hundred. A source
that is marked as stale, with the reason, has a line that says so below each table that shows it.
"""

import datetime
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.code_hash import code_hash
from experiments.pages.page import number
from features.errors import InputError
from pipeline.toml_tables import read_toml

PLACE = re.compile(r"\{([^{}/]+)/([^{}:]+):([^{}]+)\}")
BLOCK = re.compile(r"(<!-- table: ([\w-]+) -->\n)(.*?)(<!-- end of table -->)", re.DOTALL)
# Significant digits that are kept of a figure: more than any table shows.
DIGITS = 5


def read_results(path: Path) -> dict[str, Any]:
    """The sources by name, each with `commands`, `date`, `figures`, `code` (as `code_hash` takes it) and its `hash`.

    A source may have `stale`: why its figures are of earlier code.

    Raises:
        InputError: there is no such file, or it holds something else.
    """
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
        for source in results.values():
            _ = [source[key] for key in ("commands", "date", "code", "hash")], source["figures"].items()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name docs/results.json") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            f"{path}: holds no sources with commands, date, code, hash and figures; see docs/results.json"
        ) from None
    return results


def write_results(path: Path, results: Mapping[str, Any]) -> None:
    """Writes what `read_results` reads."""
    path.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def read_tables(path: Path) -> dict[str, str]:
    """Each table's Markdown by name; a line with `@` stands for one a word of its `each`."""
    return {name: "".join(_lines(table)) for name, table in read_toml(path).items()}


def _lines(table: Mapping[str, Any]) -> Iterator[str]:
    for line in table["rows"].splitlines(keepends=True):
        for word in table.get("each", ()) if "@" in line else ("",):
            yield line.replace("@", word)


def rewrite(document: Path, results: Mapping[str, Any], tables: Mapping[str, str]) -> bool:
    """Writes the document's tables anew; whether it has changed.

    Raises:
        InputError: it cannot be read, or marks a table or a figure that there is not.
    """
    try:
        before = document.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{document}: cannot be read ({error.strerror}); name a document") from None

    def block(found: re.Match[str]) -> str:
        if found[2] not in tables:
            raise InputError(f"{document}: no table '{found[2]}'; known are {', '.join(tables)}")
        return found[1] + filled(tables[found[2]], results) + found[4]

    # Before anything is written: a table that is not closed would take the text down to the next one's end with it.
    if before.count("<!-- table: ") != len(BLOCK.findall(before)):
        raise InputError(f"{document}: a table is not closed; write '<!-- end of table -->' below it")
    after = BLOCK.sub(block, before)
    if after != before:
        document.write_text(after, encoding="utf-8")
    return after != before


def filled(table: str, results: Mapping[str, Any]) -> str:
    """The table with every figure in its place, and a line for each stale source below it.

    Raises:
        InputError: a figure is missing.
    """

    def figure(found: re.Match[str]) -> str:
        source, key, form = found.groups()
        try:
            return _shown(results[source]["figures"][key], form)
        except KeyError:
            raise InputError(
                f"no figure '{key}' of '{source}'; measure it, or take it out of the tables"
            ) from None

    text = PLACE.sub(figure, table)
    for name in dict.fromkeys(name for name, _, _ in PLACE.findall(table)):
        if why := results[name].get("stale"):
            day = results[name]["date"]
            text += f"\n*`{name}`: measured with an earlier version of the code ({day}): {why}.*\n"
    return text


def _shown(value: float, form: str) -> str:
    if form == "%":
        return f"{100 * value:.0f}"
    return number(value, int(form)) if form.isdigit() else format(value, form)


def hash_of(source: Mapping[str, Any]) -> str:
    """The present code of a source, as its `hash`."""
    return code_hash(source["code"])[:16]


def outdated(results: Mapping[str, Any]) -> list[str]:
    """The sources that were measured with other code than the present one."""
    return [name for name, source in results.items() if source["hash"] != hash_of(source)]


def take(results: dict[str, Any], source: str, figures: Mapping[str, Any]) -> None:
    """Puts new figures of a source in place of its old ones, with today's date and code: it is no longer stale.

    figures: numbers, or tables of them, whose keys are joined by `/`.
    """
    entry = results[source]
    entry["hash"] = hash_of(entry)
    entry.pop("stale", None)
    entry["date"] = datetime.datetime.now(datetime.UTC).date().isoformat()
    entry["figures"] |= {
        key: float(f"{value:.{DIGITS}g}") for key, value in _flat(figures) if value is not None
    }


def take_evaluation(results: dict[str, Any], source: str, folder: Path, tables: Mapping[str, str]) -> None:
    """Takes from an evaluation's metrics.json what the tables show of this source.

    Raises:
        InputError: there is no such file, or it lacks a figure.
    """
    path = folder / "metrics.json"
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        found["bounds"] = {bound["name"]: bound for bound in found["bounds"]}
        metrics = dict(_flat(found))
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{path}: cannot be read; name the folder that 'softslide evaluate' wrote") from None
    wanted = keys_of(source, tables.values())
    if missing := [key for key in wanted if metrics.get(key) is None]:
        raise InputError(f"{path}: holds no {missing[0]}; evaluate the splits that the tables show")
    take(results, source, {key: metrics[key] for key in wanted})


def keys_of(source: str, tables: Sequence[str] | Any) -> list[str]:
    """The figures of a source that tables show, each once."""
    found = [key for table in tables for name, key, _ in PLACE.findall(table) if name == source]
    return list(dict.fromkeys(found))


def _flat(values: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The numbers of nested tables, with the way to each."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}/")
        elif value is None or (isinstance(value, int | float) and not isinstance(value, bool)):
            yield f"{prefix}{key}", value

"""What the studies' scripts share: `--help`, `--json FILE`, figures printed as they come, errors in one line."""

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from softslide.features.errors import InputError

# A part of a study by name: its one figure, or several by name.
Part = tuple[str, float | Mapping[str, float]]
Study = Callable[[argparse.Namespace], Iterator[Part]]


def parser(name: str, doc: str | None) -> argparse.ArgumentParser:
    """Of the script NAME.py, with its docstring as help."""
    made = _described(name, doc)
    made.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    return made


def write_page(
    name: str, doc: str | None, page: Path, text: Callable[[], str], argv: Sequence[str] | None = None
) -> int:
    """Of the script NAME.py that writes one page of the project, or another file with --out. Returns 0."""
    words = _described(name, doc)
    words.add_argument("--out", type=Path, default=page, metavar="FILE", help=f"in place of {page.name}")
    words.parse_args(argv).out.write_text(text(), encoding="utf-8")
    return 0


def _described(name: str, doc: str | None) -> argparse.ArgumentParser:
    return argparse.ArgumentParser(
        prog=f"python -m softslide.experiments.studies.{name}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def recordings(parser: argparse.ArgumentParser, help: str) -> None:
    """--recordings DIR"""
    parser.add_argument("--recordings", type=Path, required=True, metavar="DIR", help=help)


def bundle(parser: argparse.ArgumentParser) -> None:
    """--model BUNDLE"""
    parser.add_argument("--model", type=Path, required=True, metavar="BUNDLE", help="from 'softslide train'")


def count(
    parser: argparse.ArgumentParser, name: str, default: Any, help: str = "", least: int = 1, **options: Any
) -> None:
    """An option that takes whole numbers from `least` on."""

    def number(text: str) -> int:
        if int(text) < least:
            raise argparse.ArgumentTypeError(f"{text}: give {least} or more")
        return int(text)

    shown = f"{help} (default: %(default)s)".strip()
    parser.add_argument(name, type=number, default=default, metavar="N", help=shown, **options)


def run(parser: argparse.ArgumentParser, study: Study, argv: Sequence[str] | None = None) -> int:
    """Prints each part as it comes, and writes them all to `--json`. Returns 2 where the input is wrong, else 0."""
    given, figures = parser.parse_args(argv), {}
    try:
        if given.json and not given.json.parent.is_dir():
            raise InputError(f"{given.json}: there is no such folder; make it, or name another file")
        for name, found in study(given):
            figures[name] = _rounded(found)
            print(name, json.dumps(figures[name]).replace('"', "").strip("{}"), sep=": ", flush=True)
    except InputError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 0


def _rounded(found: float | Mapping[str, float]) -> dict[str, float | None] | float | None:
    """To five digits; null stands for what JSON has not, NaN."""
    if isinstance(found, Mapping):
        return {key: _rounded(value) for key, value in found.items()}  # type: ignore[misc]
    return float(f"{found:.5g}") if math.isfinite(found) else None

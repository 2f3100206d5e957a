"""Commands killed at random moments: nothing is half-written, nothing finished is lost, the next call ends well."""

import hashlib
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from forked import Commands, commands
from long_commands import SYNTHESIZE, TRAIN, a_simulation, an_evaluation, an_import, contents

from softslide.pipeline.atlas.atlas import read_atlas

KILLS = 20


@pytest.fixture(scope="module")
def softslide() -> Iterator[Commands]:
    with commands() as ready:
        yield ready


def seen(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@dataclass(frozen=True)
class Case:
    """A command that writes `out`. kept: what it keeps of a call that was killed, one file a piece of work; of an
    import the slides that are noted. content: of `out`, what does not depend on how long the work took."""

    words: list[str]
    out: str
    kept: str = ""
    content: Callable[[Path], dict[str, str]] = contents


def check(softslide: Commands, case: Case, place: Path, kills: int) -> None:
    """Kills the command at random moments; each second time the call after that is let run to its end."""
    whole, words = place / "whole", [*case.words, "--out", case.out]
    softslide.start(words, whole)
    took_s = softslide.finish()
    assert softslide.status in (0, 1), said(whole)  # 1: a bound that is not met
    expected, names = case.content(whole / case.out), seen(whole)
    assert expected
    folder, chance = place / "killed", random.Random(len(words))
    for number in range(kills):
        before = kept(folder, case.kept)
        softslide.start(words, folder)
        softslide.kill(chance.uniform(0.0, took_s))
        assert case.content(folder / case.out) in ({}, expected)
        if case.kept and not (folder / case.out).exists():
            assert kept(folder, case.kept) >= before
        if number % 2:
            softslide.start(words, folder)
            softslide.finish()
            assert softslide.status in (0, 1), said(folder)
            assert case.content(folder / case.out) == expected
            assert seen(folder) == names
            shutil.rmtree(folder)


def kept(folder: Path, pattern: str) -> set[Path]:
    found = set(folder.glob(pattern)) if pattern and folder.exists() else set()
    return {file for file in found if "raw" not in file.parts or file.with_suffix(".json").exists()}


def said(folder: Path) -> str:
    return folder.with_name(f"{folder.name}.log").read_text()


def solved(place: Path) -> dict[str, str]:
    """A hash of each array of an atlas; empty where there is no atlas."""
    if not place.exists():
        return {}
    arrays = vars(read_atlas(place))
    return {name: hashlib.sha256(a.tobytes()).hexdigest() for name, a in arrays.items() if name != "meta"}


@pytest.mark.parametrize("kills", [2, pytest.param(KILLS, marks=pytest.mark.long)])
def test_import(softslide: Commands, tmp_path: Path, kills: int) -> None:
    command = an_import(tmp_path, ("one", "two", "three", "four", "five", "six"))
    before = contents(tmp_path / "lab" / "lab")
    check(softslide, Case(command, "out", ".out.partial/raw/*.parquet"), tmp_path, kills)
    assert contents(tmp_path / "lab" / "lab") == before


CASES: dict[str, Callable[[Path], Case]] = {
    "synthesize": lambda root: Case(SYNTHESIZE, "out"),
    "evaluate": lambda root: Case([*an_evaluation(root, 13), "--no-report"], "out", ".out.work/*.npz"),
    "train": lambda root: Case(TRAIN, "out"),
    "simulate": lambda root: Case(a_simulation(root), "out.npz", ".out.npz.lines/*/*.npz", solved),
}


@pytest.mark.long
@pytest.mark.parametrize("command", CASES)
def test_others(softslide: Commands, tmp_path: Path, command: str) -> None:
    check(softslide, CASES[command](tmp_path), tmp_path, KILLS)

"""Commands killed at random moments: nothing is half-written, nothing finished is lost, the next call ends well."""

import hashlib
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from forked import Commands, commands
from lab_files import FORMATS, write_lab
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

from pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from pipeline.recordings.folder import SAMPLE

KILLS = 20


@pytest.fixture(scope="module")
def softslide() -> Iterator[Commands]:
    with commands() as ready:
        yield ready


def contents(place: Path) -> dict[str, str]:
    """A hash of each file in and below a folder, or of the file itself; empty where there is none."""
    files = [place] if place.is_file() else sorted(path for path in place.rglob("*") if path.is_file())
    return {str(path.relative_to(place)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def seen(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@dataclass(frozen=True)
class Case:
    """A command that writes `out`. kept: what it keeps of a call that was killed, one file a piece of work. content: of
    `out`, what does not depend on how long the work took."""

    words: list[str]
    out: str
    kept: str = ""
    content: Callable[[Path], dict[str, str]] = contents


def words(*given: object) -> list[str]:
    return [str(word) for word in given]


def check(softslide: Commands, case: Case, place: Path, kills: int) -> None:
    """Kills the command at random moments; each second time the call after that is let run to its end."""
    whole = place / "whole"
    softslide.start(case.words, whole)
    took_s = softslide.finish()
    assert softslide.status in (0, 1), said(whole)  # 1: a bound that is not met
    expected, names = case.content(whole / case.out), seen(whole)
    assert expected
    folder, chance = place / "killed", random.Random(len(case.words))
    for number in range(kills):
        before = set(folder.glob(case.kept)) if case.kept and folder.exists() else set()
        softslide.start(case.words, folder)
        softslide.kill(chance.uniform(0.0, took_s))
        assert case.content(folder / case.out) in ({}, expected)
        if case.kept and not (folder / case.out).exists():
            assert set(folder.glob(case.kept)) >= before
        if number % 2:
            softslide.start(case.words, folder)
            softslide.finish()
            assert softslide.status in (0, 1), said(folder)
            assert case.content(folder / case.out) == expected
            assert seen(folder) == names
            shutil.rmtree(folder)


def said(folder: Path) -> str:
    return folder.with_name(f"{folder.name}.log").read_text()


@pytest.mark.parametrize("kills", [2, pytest.param(KILLS, marks=pytest.mark.long)])
def test_import(softslide: Commands, tmp_path: Path, kills: int) -> None:
    write_lab(tmp_path / "lab", FORMATS["csv"], ("one", "two", "three", "four", "five", "six"))
    sources = tmp_path / "lab" / "lab"
    before = contents(sources)
    command = words("import", sources, "--map", tmp_path / "lab" / "map.toml", "--out", "out")
    check(softslide, Case(command, "out", ".out.partial/raw/*.parquet"), tmp_path, kills)
    assert contents(sources) == before


@pytest.mark.long
def test_synthesize(softslide: Commands, tmp_path: Path) -> None:
    command = words("synthesize", "--slides", 3, "--seed", 4, "--out", "out")
    check(softslide, Case(command, "out"), tmp_path, KILLS)


@pytest.mark.long
def test_evaluate(softslide: Commands, tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)
    lab = a_folder(tmp_path / "lab", **{f"r{n}": {} for n in range(13)}).root
    command = words("evaluate", "--model", bundle, "--recordings", lab, "--out", "out", "--no-report")
    check(softslide, Case(command, "out", ".out.work/*.parquet"), tmp_path, KILLS)


@pytest.mark.long
def test_train(softslide: Commands, tmp_path: Path) -> None:
    command = words("train", "--recordings", SAMPLE, "--model", "interpolation", "--out", "out")
    check(softslide, Case(command, "out"), tmp_path, KILLS)


def solved(place: Path) -> dict[str, str]:
    """A hash of each array of an atlas; empty where there is none."""
    if not place.exists():
        return {}
    arrays = vars(read_atlas(place))
    return {name: hashlib.sha256(a.tobytes()).hexdigest() for name, a in arrays.items() if name != "meta"}


@pytest.mark.long
def test_simulate(softslide: Commands, tmp_path: Path) -> None:
    text = DEFAULT_SENSOR.read_text().replace("[5.0, 7.0, 9.6]", "[6.0]")
    sensor = tmp_path / "sensor.toml"
    sensor.write_text(text.replace("size_mm = 2.5", "size_mm = 5.0"))
    command = words("simulate", "--sensor", sensor, "--coarse", "--depth", 0.5, "--out", "out.npz")
    check(softslide, Case(command, "out.npz", ".out.npz.lines/*/*.npz", solved), tmp_path, KILLS)

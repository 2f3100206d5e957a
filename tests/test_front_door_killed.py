"""Commands killed at random moments: nothing is half-written, nothing finished is lost, the next call ends well."""

import hashlib
import random
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import mlflow
import optuna
import pytest
from forked import Commands, commands
from lab_files import FORMATS, write_lab
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

from pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from pipeline.recordings.folder import SAMPLE, read_folder, write_folder

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


SWEEP = """
model = "trees"
recordings = {recordings!r}
budget.trials = 4
settings.trees = 2
space.least_leaf = {{ low = 2, high = 12 }}
"""


def values(journal: Path) -> list[float]:
    """Those of the trials that have ended, in their order; none where there is no journal yet."""
    if not journal.exists():
        return []
    text = journal.read_bytes()
    # The copy is read: what a killed process left of its last line is cut off by the next call alone.
    copy = journal.with_suffix(".copy")
    copy.write_bytes(text[: text.rfind(b"\n") + 1])
    storage = JournalStorage(JournalFileBackend(str(copy)))
    names = optuna.get_all_study_names(storage)
    studies = [optuna.load_study(study_name=name, storage=storage) for name in names]
    found = [t.value for s in studies for t in s.get_trials(states=(TrialState.COMPLETE,))]
    copy.unlink()
    return [value for value in found if value is not None]


@pytest.mark.long
def test_sweep(softslide: Commands, tmp_path: Path) -> None:
    """A trial that has ended stays; a call that is let run does the rest, and no run stays under way."""
    folder, chance = tmp_path / "killed", random.Random(5)
    lab = read_folder(SAMPLE).select("calibration")
    fastest = lab.manifest["speed_mm_s"].nlargest(12).index
    recordings = [lab.load(str(name)) for name in fastest]
    write_folder(tmp_path / "lab", lab.sensor, lab.manifest.loc[fastest], recordings)
    command = words("sweep", "--config", "s.toml")
    store = f"sqlite:///{tmp_path / 'killed.store' / 'mlflow.db'}"

    def begin() -> None:
        folder.mkdir(exist_ok=True)
        (folder / "s.toml").write_text(SWEEP.format(recordings=str(tmp_path / "lab")))
        softslide.start(command, folder)

    begin()
    took_s = softslide.finish()
    assert softslide.status == 0, said(folder)
    shutil.rmtree(folder)
    for number in range(KILLS):
        begin()
        before = values(folder / "s.journal")
        softslide.kill(chance.uniform(0.0, took_s))
        after = values(folder / "s.journal")
        assert after[: len(before)] == before
        page = folder / "s.html"
        assert not page.exists() or page.read_text().rstrip().endswith("</html>")
        if number % 2:
            begin()
            softslide.finish()
            assert softslide.status == 0, said(folder)
            ended = values(folder / "s.journal")
            assert ended[: len(after)] == after
            assert len(ended) == 4
            assert seen(folder) == {"s.toml", "s.journal", "s.html"}
            runs = mlflow.MlflowClient(store, store).search_runs(["1"])
            assert {run.info.status for run in runs} <= {"FINISHED", "KILLED"}
            shutil.rmtree(folder)

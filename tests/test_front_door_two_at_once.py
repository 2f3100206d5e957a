"""A command called twice at once for one output: both end well, or one says that the other is at work on it."""

import hashlib
import time
from collections.abc import Iterator
from pathlib import Path

import mlflow
import pytest
from forked import Commands, commands
from lab_files import FORMATS, write_lab
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

from pipeline.recordings.folder import SAMPLE

pytestmark = pytest.mark.long
AT_WORK = "another call is at work on it; wait for it, or name another folder"


@pytest.fixture(scope="module")
def two() -> Iterator[tuple[Commands, Commands]]:
    with commands() as one, commands() as other:
        yield one, other


def contents(folder: Path) -> dict[str, str]:
    """A hash of each file in and below a folder."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def statuses(two: tuple[Commands, Commands], given: list[object], folder: Path) -> list[int]:
    """Of two calls at once, then of a second one in the midst of a first one; the output is that of a call alone.

    Each runs in a folder of its own below this one, with one output `out` and one store.
    """
    command = [*map(str, given), "--out", str(folder / "out")]
    places = [folder / "one", folder / "two"]
    (folder / "store").mkdir(parents=True)
    for place in places:
        place.with_name(f"{place.name}.store").symlink_to(folder / "store")
    two[0].start(command, places[0])
    took_s = two[0].finish()
    assert two[0].status == 0, (folder / "one.log").read_text()
    alone, found = contents(folder / "out"), []
    for delay_s in (0.0, took_s / 2):
        two[0].start(command, places[0])
        time.sleep(delay_s)
        two[1].start(command, places[1])
        for each, place in zip(two, places, strict=True):
            each.finish()
            found.append(each.status)
            said = place.with_name(f"{place.name}.log").read_text()
            assert "Traceback" not in said
            assert each.status == 0 or (each.status == 2 and said.splitlines()[-1].endswith(AT_WORK)), said
        assert contents(folder / "out") == alone
        assert not [path.name for path in folder.iterdir() if path.name.startswith(".")]
    return found


def test_synthesize(two: tuple[Commands, Commands], tmp_path: Path) -> None:
    assert statuses(two, ["synthesize", "--slides", 3, "--seed", 4], tmp_path / "w") == [0, 0, 0, 0]


def test_import(two: tuple[Commands, Commands], tmp_path: Path) -> None:
    write_lab(tmp_path / "lab", FORMATS["csv"], ("one", "two", "three", "four", "five", "six"))
    given = ["import", tmp_path / "lab" / "lab", "--map", tmp_path / "lab" / "map.toml"]
    found = statuses(two, given, tmp_path / "w")
    assert 0 in found[:2]
    assert 0 in found[2:]


def test_train(two: tuple[Commands, Commands], tmp_path: Path) -> None:
    """Each is a run that has finished."""
    given = ["train", "--recordings", SAMPLE, "--model", "interpolation"]
    assert statuses(two, given, tmp_path / "w") == [0, 0, 0, 0]
    store = f"sqlite:///{tmp_path / 'w' / 'store' / 'mlflow.db'}"
    runs = mlflow.MlflowClient(store, store).search_runs(["1"])
    assert [run.info.status for run in runs] == 5 * ["FINISHED"]


def test_evaluate(two: tuple[Commands, Commands], tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)
    lab = a_folder(tmp_path / "lab", **{f"r{n}": {} for n in range(13)}).root
    given = ["evaluate", "--model", bundle, "--recordings", lab, "--allow-untested", "--no-report"]
    found = statuses(two, given, tmp_path / "w")
    assert 0 in found[:2]
    assert 0 in found[2:]

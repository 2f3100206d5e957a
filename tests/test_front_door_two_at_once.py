"""A command called twice at once for one output: both end well, or one says that the other is at work on it."""

import time
from collections.abc import Iterator
from pathlib import Path

import mlflow
import pytest
from forked import LOADED, Commands, commands
from long_commands import SYNTHESIZE, TRAIN, an_evaluation, an_import, contents

pytestmark = pytest.mark.long
AT_WORK = "another call is at work on it; wait for it, or name another folder"


@pytest.fixture(scope="module")
def two() -> Iterator[tuple[Commands, Commands]]:
    with commands(loaded=tuple(LOADED)) as one, commands(loaded=tuple(LOADED)) as other:
        yield one, other


def statuses(two: tuple[Commands, Commands], given: list[str], folder: Path) -> list[int]:
    """Of two calls at once, then of a second one in the midst of a first one; the output is that of a call alone.

    Each runs in a folder of its own below this one, with one output `out` and one store.
    """
    command = [*given, "--out", str(folder / "out")]
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
    assert statuses(two, SYNTHESIZE, tmp_path / "w") == [0, 0, 0, 0]


def test_train(two: tuple[Commands, Commands], tmp_path: Path) -> None:
    """Each is a run that has finished."""
    assert statuses(two, TRAIN, tmp_path / "w") == [0, 0, 0, 0]
    store = f"sqlite:///{tmp_path / 'w' / 'store' / 'mlflow.db'}"
    runs = mlflow.MlflowClient(store, store).search_runs(["1"])
    assert [run.info.status for run in runs] == 5 * ["FINISHED"]


@pytest.mark.parametrize("command", ["import", "evaluate"])
def test_one_of_two_that_work_on_one_output(
    two: tuple[Commands, Commands], tmp_path: Path, command: str
) -> None:
    if command == "import":
        given = an_import(tmp_path, ("one", "two", "three", "four", "five", "six"))
    else:
        given = [*an_evaluation(tmp_path, 13), "--no-report"]
    found = statuses(two, given, tmp_path / "w")
    assert 0 in found[:2]
    assert 0 in found[2:]

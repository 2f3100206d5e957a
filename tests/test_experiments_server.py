"""A team's store: MLflow's server on PostgreSQL, several at once, and what happens when it dies."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import mlflow
import pytest
from log_run import log_run
from small_bundle import write_small_bundle
from team_server import PATIENCE_S, binaries, free_port, mlflow_server, postgres
from trial_folder import SENSOR

from softslide.experiments.tracking import fetched, find_run
from softslide.serve.localizer import Localizer

HERE = Path(__file__).parents[1]


def log_at_once(store: str, root: Path, names: list[str]) -> None:
    """Each name's run from a process of its own, all at the same time."""
    environment = {**os.environ, "MLFLOW_TRACKING_URI": store, "PYTHONPATH": str(HERE)}
    running = []
    for name in names:
        bundle = write_small_bundle(root / name, SENSOR)
        command = [sys.executable, str(HERE / "tests" / "worlds" / "log_run.py"), str(bundle), name]
        pipe = subprocess.PIPE
        running.append(subprocess.Popen(command, env=environment, cwd=root, stdout=pipe, stderr=pipe))
    said = [process.communicate(timeout=PATIENCE_S) for process in running]
    assert [process.returncode for process in running] == [0] * len(names), said
    assert said == [(b"", b"")] * len(names)


def assert_whole(client: mlflow.MlflowClient, name: str) -> None:
    """The member's run with everything that was logged."""
    run = find_run(client, {"member": name})
    assert run is not None
    assert run.info.status == "FINISHED"
    assert run.data.metrics == {"loss": 1.0, "parity": 1e-6}
    assert len(client.get_metric_history(run.info.run_id, "loss")) == 2
    assert {"bundle", "configuration.json"} <= {item.path for item in client.list_artifacts(run.info.run_id)}


def test_two_at_once_make_and_share_one_local_store(tmp_path: Path) -> None:
    """Neither waits for the other's end, and the store's tables are made once."""
    store = f"sqlite:///{tmp_path / 'new' / 'mlflow.db'}"
    log_at_once(store, tmp_path, ["ada", "ben"])
    client = mlflow.MlflowClient(store, store)
    for name in ("ada", "ben"):
        assert_whole(client, name)
    assert len(client.search_experiments(filter_string="name = 'softslide'")) == 1
    assert {each.version for each in client.search_model_versions("name = 'softslide'")} == {1, 2}


@pytest.fixture(scope="module")
def database() -> Iterator[str]:
    if binaries() is None:
        pytest.skip("PostgreSQL is not installed")
    with postgres() as address:
        yield address


def test_a_team_shares_a_server_that_may_die(
    database: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two members at once; then the server dies in the middle of a run, which costs a line and no traceback."""
    bundle = write_small_bundle(tmp_path / "caught", SENSOR)
    with ExitStack() as stack:
        store = stack.enter_context(mlflow_server(database, tmp_path / "artifacts", free_port()))
        monkeypatch.setenv("MLFLOW_TRACKING_URI", store)
        log_at_once(store, tmp_path, ["ada", "ben"])
        client = mlflow.MlflowClient(store, store)
        for name in ("ada", "ben"):
            assert_whole(client, name)
        again = fetched("models:/softslide/2", tmp_path / "fetched")
        assert Localizer.load(again).card.model == "small"
        capsys.readouterr()
        log_run(bundle, "caught", store, midway=stack.close)
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"run not logged: {store} does not take it")

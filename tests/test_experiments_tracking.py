"""What a run logs, that a store which is gone costs the run alone, and that nobody else is informed."""

import math
import os
import subprocess
import sys
from pathlib import Path

import mlflow
import pytest
from small_bundle import write_small_bundle

from softslide.experiments import provenance
from softslide.experiments.code_hash import code_hash
from softslide.experiments.flattened import flattened
from softslide.experiments.provenance import code_revision, data_hashes
from softslide.experiments.tracking import client_of, fetched, find_run, tracked
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder

HERE = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def folder() -> Folder:
    return read_folder(SAMPLE).select("calibration-diagonal")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> str:
    return f"sqlite:///{tmp_path_factory.mktemp('store') / 'mlflow.db'}"


@pytest.fixture(scope="module")
def bundle(folder: Folder, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_bundle(tmp_path_factory.mktemp("tracked") / "bundle", folder.sensor)


@pytest.fixture(scope="module")
def client(store: str, bundle: Path, folder: Folder) -> mlflow.MlflowClient:
    """Of a store with one run that has everything that a training logs."""
    configuration = {"model": "small", "settings": {"training": {"steps": 3}}}
    with tracked("train", "small on bench-a", configuration, tags=data_hashes(folder), store=store) as run:
        run.data(folder, "training")
        run.files(bundle, "bundle")
        run.tags({"bundle": "its hash"})
        run.losses({0: 2.0, 50: 1.0})
        run.metrics({"parity": 1e-6, "unknown": math.nan})
        run.text("<svg/>", "figures/one.svg")
        run.register({"bundle": "its hash"})
    return client_of(store)


@pytest.fixture(scope="module")
def logged(client: mlflow.MlflowClient) -> mlflow.entities.Run:
    found = find_run(client, {"bundle": "its hash"})
    assert found is not None
    return found


def test_a_run_holds_configuration_data_and_metrics(
    store: str, client: mlflow.MlflowClient, logged: mlflow.entities.Run, folder: Folder
) -> None:
    assert logged.info.status == "FINISHED"
    assert logged.data.params == {"command": "train", "model": "small", "settings.training.steps": "3"}
    assert logged.data.metrics == {"parity": 1e-6, "loss": 1.0}
    history = client.get_metric_history(logged.info.run_id, "loss")
    assert {m.step: m.value for m in history} == {0: 2.0, 50: 1.0}
    assert logged.data.tags.items() >= {**data_hashes(folder), "code": code_revision()}.items()
    assert [d.dataset.name for d in logged.inputs.dataset_inputs] == ["bench-a"]
    files = {item.path for item in client.list_artifacts(logged.info.run_id)}
    assert files == {"bundle", "configuration.json", "environment.txt", "figures", "machine.json"}
    next_to_the_store = (Path(store.removeprefix("sqlite:///")).parent / "mlartifacts").as_uri()
    assert logged.info.artifact_uri.startswith(next_to_the_store)


def test_a_registered_bundle_is_fetched_by_version_and_by_alias(
    store: str, client: mlflow.MlflowClient, bundle: Path, tmp_path: Path
) -> None:
    client.set_registered_model_alias("softslide", "champion", "1")
    for address, name in (("softslide/1", "softslide-1"), ("softslide@champion", "softslide-champion")):
        got = fetched(f"models:/{address}", tmp_path, store)
        assert got.name == name
        assert (got / "model.json").read_bytes() == (bundle / "model.json").read_bytes()


@pytest.mark.parametrize("address", ["softslide/7", "softslide@none", "softslide", "other/1", "@", ""])
def test_what_is_not_registered_is_refused(
    store: str, client: mlflow.MlflowClient, tmp_path: Path, address: str
) -> None:
    with pytest.raises(InputError, match=r"not found in sqlite.*MLFLOW_TRACKING_URI"):
        fetched(f"models:/{address}", tmp_path, store)


def test_a_run_that_breaks_off_is_marked_as_failed(client: mlflow.MlflowClient, store: str) -> None:
    with pytest.raises(KeyError), tracked("broken", "broken", {}, store=store):
        raise KeyError
    run = find_run(client, {"command": "broken"})
    assert run is not None
    assert run.info.status == "FAILED"


def test_a_store_that_is_down_costs_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    nowhere = f"sqlite:///{tmp_path / 'file' / 'below' / 'mlflow.db'}"
    with tracked("train", "x", {}, store=nowhere) as run:
        run.metrics({"direction_deg": 1.0})
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"run not logged: {nowhere} does not take it")
    assert run.place == "no run"


def test_runs_are_logged_where_files_have_no_locks_and_nothing_is_sent(tmp_path: Path) -> None:
    """As on Windows, which has no fcntl."""
    program = (
        "import os, sys; sys.modules['fcntl'] = None\n"
        "import experiments.train; from experiments.tracking import tracked\n"
        "with tracked('train', 'x', {}, store='sqlite:///mlflow.db') as run: run.metrics({'a': 1.0})\n"
        "assert os.environ['MLFLOW_DISABLE_TELEMETRY'] == 'true'"
    )
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    del environment["MLFLOW_DISABLE_TELEMETRY"]
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, env=environment, check=True, timeout=300)
    run = find_run(client_of(f"sqlite:///{tmp_path / 'mlflow.db'}"), {"command": "train"}, "FINISHED")
    assert run is not None
    assert run.data.metrics == {"a": 1.0}


def test_hashes_differ_with_data_and_not_with_places(folder: Folder, tmp_path: Path) -> None:
    names = list(folder.manifest.index[:2])
    manifest = folder.manifest.loc[names]

    def copy(place: str, change: float = 0.0, label: float = 0.0) -> dict[str, str]:
        recordings = [folder.load(name) for name in names]
        recordings[0].volts[7, 1] += change
        table = manifest.assign(offset_mm=manifest["offset_mm"] + label)
        return data_hashes(write_folder(tmp_path / place, folder.sensor, table, recordings))

    same, again, volts, labels = copy("a"), copy("b"), copy("c", change=5e-4), copy("d", label=0.1)
    assert same == again
    assert {key for key in same if same[key] != volts[key]} == {"slides"}
    assert {key for key in same if same[key] != labels[key]} == {"manifest"}


def test_the_code_that_ran_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commit, with a mark where a file differs from it; outside a clone nothing is claimed."""
    code = tmp_path / "code"
    code.mkdir()
    monkeypatch.setattr(provenance, "__file__", str(code / "provenance.py"))
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path))
    named = code_revision.__wrapped__
    assert named() == "unknown"

    def git(*words: str) -> str:
        author = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        return subprocess.run(
            ["git", *author, *words], cwd=code, capture_output=True, text=True, check=True
        ).stdout.strip()

    git("init", "--quiet")
    (code / "gain.py").write_text("gain = 1\n")
    git("add", "gain.py")
    git("commit", "--quiet", "--message", "Gain")
    commit = git("rev-parse", "HEAD")
    assert named() == commit
    (code / "gain.py").write_text("gain = 2\n")
    assert named() == f"{commit}+{code_hash()[:12]}"


def test_nested_settings_become_dotted_names() -> None:
    assert flattened({"a": {"b": {"c": 1}, "d": None}, "e": (1, 2)}) == {"a.b.c": 1, "a.d": None, "e": (1, 2)}

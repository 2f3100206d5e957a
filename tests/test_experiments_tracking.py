"""What a run logs, what it keeps when the store is gone, and that nobody else is told."""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import mlflow
import pandas as pd
import pytest
from small_bundle import write_small_bundle

import softslide
from experiments.provenance import code_revision, data_hashes
from experiments.tracking.process import is_gone, process_tags
from experiments.tracking.run import flattened, tracked
from experiments.tracking.store import find_run
from experiments.tracking.study import tracked_study
from experiments.tracking.unsent import sync
from features.errors import InputError
from pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder

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


def log_all(bundle: Path, folder: Folder, store: str) -> None:
    """A run with everything that a training logs."""
    configuration = {"model": "small", "settings": {"training": {"steps": 3}}}
    tags = data_hashes(folder)
    with tracked("train", "small on bench-a", configuration, bundle, tags=tags, store=store) as run:
        run.data(folder, "training")
        run.model(bundle, "small")
        run.tags({"bundle": "its hash"})
        run.losses({0: 2.0, 50: 1.0})
        run.metrics({"parity": 1e-6})
        run.text("<svg/>", "figures/one.svg")
        run.register("small", {"bundle": "its hash"})


@pytest.fixture(scope="module")
def client(store: str, bundle: Path, folder: Folder) -> mlflow.MlflowClient:
    log_all(bundle, folder, store)
    return mlflow.MlflowClient(store, store)


@pytest.fixture(scope="module")
def logged(client: mlflow.MlflowClient) -> mlflow.entities.Run:
    found = find_run(client, {"bundle": "its hash"})
    assert found is not None
    return found


def test_a_run_holds_configuration_data_and_metrics(
    client: mlflow.MlflowClient, logged: mlflow.entities.Run, folder: Folder
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


def test_files_lie_beside_the_store(
    store: str, client: mlflow.MlflowClient, logged: mlflow.entities.Run
) -> None:
    beside = (Path(store.removeprefix("sqlite:///")).parent / "mlartifacts").as_uri()
    model = client.get_logged_model(logged.outputs.model_outputs[0].model_id)
    assert logged.info.artifact_uri.startswith(beside)
    assert model.artifact_location.startswith(beside)


def test_metrics_belong_to_the_model(client: mlflow.MlflowClient, logged: mlflow.entities.Run) -> None:
    model = client.get_logged_model(logged.outputs.model_outputs[0].model_id)
    assert {(m.key, m.value) for m in model.metrics} >= {("parity", 1e-6), ("loss", 1.0)}


def test_the_model_answers_what_predict_answers(
    client: mlflow.MlflowClient, folder: Folder, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    """From the registry, without a pickle, from a table of time and volts, to the last digit."""
    files = Path(mlflow.artifacts.download_artifacts("models:/small/1", dst_path=str(tmp_path)))
    assert not [path for path in files.rglob("*") if path.suffix in (".pkl", ".pickle", ".joblib")]
    pins = {pin.partition("==")[0] for pin in (files / "requirements.txt").read_text().split()}
    assert pins == {"mlflow", "numpy", "onnxruntime"}
    name = str(folder.manifest["speed_mm_s"].idxmax())
    recording = folder.load(name)
    table = pd.DataFrame(recording.volts, columns=list(folder.sensor.channels))
    table.insert(0, "time_s", recording.time_s)
    table.to_csv(tmp_path / "slide.csv", index=False)
    model = mlflow.pyfunc.load_model("models:/small/1")
    for options, params in ((["--track"], {"track": True}), ([], None)):
        command = ["predict", "--model", bundle, *options, tmp_path / "slide.csv"]
        assert softslide.main([str(word) for word in command]) == 0
        told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        for line in told:
            del line["recording"], line["file"]
        assert json.loads(json.dumps(model.predict(table, params=params))) == told
    with pytest.raises(InputError, match="row 3, column a0_vx is nan"):
        model.predict(table.assign(a0_vx=[1.0, 1.0, math.nan, *recording.volts[3:, 0]]))


def test_a_run_that_breaks_off_is_marked_as_failed(
    client: mlflow.MlflowClient, store: str, tmp_path: Path
) -> None:
    with pytest.raises(KeyError), tracked("broken", "broken", {}, tmp_path / "out", store=store):
        raise KeyError
    run = find_run(client, {"command": "broken"})
    assert run is not None
    assert run.info.status == "FAILED"


def test_a_run_whose_process_was_killed_is_marked_by_the_next(tmp_path: Path) -> None:
    """Two processes begin runs; one of them is killed, and the run of the other goes on."""
    store = f"sqlite:///{tmp_path / 'mlflow.db'}"
    environment = {**os.environ, "MLFLOW_TRACKING_URI": store, "PYTHONPATH": str(HERE)}
    command = [sys.executable, str(HERE / "tests" / "worlds" / "begun_run.py"), str(tmp_path)]
    killed, alive = (subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) for _ in range(2))
    try:
        for process in (killed, alive):
            assert process.stdout is not None
            assert process.stdout.readline() == b"begun\n"
        killed.kill()
        killed.wait()
        with tracked("train", "next", {}, tmp_path / "out", store=store):
            pass
        runs = mlflow.MlflowClient(store, store).search_runs(["1"])
        status = {run.data.tags["process"].split()[0]: run.info.status for run in runs}
        assert status[str(killed.pid)] == "KILLED"
        assert status[str(alive.pid)] == "RUNNING"
        assert status[str(os.getpid())] == "FINISHED"
    finally:
        for process in (killed, alive):
            process.kill()
            process.communicate()


def test_only_a_process_that_is_surely_gone_is_gone() -> None:
    """Not this one, none of another computer, and none before its number was given away again."""
    here = process_tags()
    with subprocess.Popen([sys.executable, "-c", ""]) as short:
        pass
    assert is_gone({**here, "process": f"{short.pid} 1"})
    assert not is_gone({**here, "process": f"{short.pid} 1", "host": "elsewhere"})
    assert not is_gone(here)
    assert not is_gone({})
    identifier, _, started = here["process"].partition(" ")
    if started:
        assert is_gone({**here, "process": f"{identifier} {int(started) - 1}"})


def test_a_study_is_a_run_with_one_below_it_for_each_part(tmp_path: Path) -> None:
    store = f"sqlite:///{tmp_path / 'mlflow.db'}"
    with tracked_study("few", "few on x", {"draws": 2}, tmp_path / "few", store=store) as (_, part):
        for draw in range(2):
            part(f"draw {draw}", {"draw": draw}, {"direction_deg": draw / 2, "offset_mm": math.nan})
    client = mlflow.MlflowClient(store, store)
    whole = find_run(client, {"command": "few"})
    parts = client.search_runs(["1"], "tags.command = 'few part'")
    assert whole is not None
    assert {run.data.tags["mlflow.parentRunId"] for run in parts} == {whole.info.run_id}
    assert {run.data.params["draw"]: run.data.metrics for run in parts} == {
        "0": {"direction_deg": 0.0},
        "1": {"direction_deg": 0.5},
    }


def test_a_study_that_no_store_took_is_sent_with_its_parts_below_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "store").write_text("a file where the store's folder should be")
    later = f"sqlite:///{tmp_path / 'store' / 'mlflow.db'}"
    with tracked_study("few", "few on x", {}, tmp_path / "few", store=later) as (_, part):
        part("draw 0", {}, {})
    (tmp_path / "store").unlink()
    monkeypatch.delenv("MLFLOW_TRACKING_URI")
    assert len(sync([tmp_path])) == 2
    client = mlflow.MlflowClient(later, later)
    whole, below = find_run(client, {"command": "few"}), find_run(client, {"command": "few part"})
    assert whole is not None
    assert below is not None
    assert below.data.tags["mlflow.parentRunId"] == whole.info.run_id


def test_what_cannot_even_be_kept_costs_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    nowhere = tmp_path / "file" / "below"
    with tracked("few", "few", {}, nowhere / "few", store=f"sqlite:///{nowhere / 'mlflow.db'}") as run:
        run.metrics({"direction_deg": 1.0})
    (line,) = capsys.readouterr().err.splitlines()
    assert "nor can it be kept" in line


def test_what_a_store_does_not_take_is_kept_and_sent_later(
    bundle: Path,
    folder: Folder,
    tmp_path: Path,
    logged: mlflow.entities.Run,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A store that cannot be opened for a while: the run is then there as any other, files and model included."""
    moved = tmp_path / "moved"
    shutil.copytree(bundle, moved)
    (tmp_path / "store").write_text("a file where the store's folder should be")
    later = f"sqlite:///{tmp_path / 'store' / 'mlflow.db'}"
    log_all(moved, folder, later)
    kept = tmp_path / "moved.unsent"
    (line,) = capsys.readouterr().err.splitlines()
    assert f"softslide sync {kept}" in line
    shutil.rmtree(moved)
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("MLFLOW_TRACKING_URI")
        assert softslide.main(["sync", str(kept)]) == 1
        assert "are kept, run 'softslide sync' again" in capsys.readouterr().err
        (tmp_path / "store").unlink()
        assert softslide.main(["sync", str(tmp_path)]) == 0
    assert not kept.exists()
    sent = find_run(mlflow.MlflowClient(later, later), {"bundle": "its hash"})
    assert sent is not None
    assert sent.data.params == logged.data.params
    assert sent.data.metrics == logged.data.metrics
    assert (sent.info.status, len(sent.outputs.model_outputs)) == ("FINISHED", 1)
    assert mlflow.MlflowClient(later, later).get_model_version("small", "1").tags == {"bundle": "its hash"}


def test_runs_are_logged_where_files_have_no_locks(tmp_path: Path) -> None:
    """As on Windows, which has no fcntl."""
    program = (
        "import sys; sys.modules['fcntl'] = None; from pathlib import Path; import experiments.sweep.search, "
        "experiments.train; from experiments.tracking.run import tracked\n"
        "with tracked('train', 'x', {}, Path('out'), store='sqlite:///mlflow.db') as run: run.metrics({'a': 1.0})"
    )
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    command = [sys.executable, "-c", program]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True, timeout=300)
    store = f"sqlite:///{tmp_path / 'mlflow.db'}"
    run = find_run(mlflow.MlflowClient(store, store), {"command": "train"}, "FINISHED")
    assert run is not None
    assert run.data.metrics == {"a": 1.0}


def test_nothing_is_sent() -> None:
    assert os.environ["MLFLOW_DISABLE_TELEMETRY"] == "true"


def test_hashes_tell_data_apart_and_places_not(folder: Folder, tmp_path: Path) -> None:
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


def test_the_code_that_ran_is_named() -> None:
    commit, _, changes = code_revision().partition("+")
    assert (len(commit) == 40 and len(changes) in (0, 12)) or code_revision() == "unknown"


def test_nested_settings_become_dotted_names() -> None:
    assert flattened({"a": {"b": {"c": 1}, "d": None}, "e": (1, 2)}) == {"a.b.c": 1, "a.d": None, "e": (1, 2)}

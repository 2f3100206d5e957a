"""A run keeps what it takes to repeat it, and nobody is told."""

import os
from pathlib import Path

import mlflow
import numpy as np
import pytest
from small_bundle import write_small_bundle

from experiments.tracking import code_revision, data_hashes, flattened, tracked
from pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder


@pytest.fixture(scope="module")
def folder() -> Folder:
    return read_folder(SAMPLE).select("calibration-diagonal")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> str:
    return f"sqlite:///{tmp_path_factory.mktemp('store') / 'mlflow.db'}"


@pytest.fixture(scope="module")
def identifier(store: str, folder: Folder, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A run with everything that a training logs."""
    bundle = write_small_bundle(tmp_path_factory.mktemp("tracked") / "bundle", folder.sensor)
    configuration = {"model": "small", "settings": {"training": {"steps": 3}}}
    with tracked("small on bench-a", configuration, data_hashes(folder), store) as run:
        run.data(folder, "training")
        logged = run.model(bundle, "small")
        run.losses({0: 2.0, 50: 1.0})
        run.metrics({"parity": 1e-6}, logged)
        run.text("<svg/>", "figures/one.svg")
    return run.identifier


def test_a_run_holds_configuration_data_and_metrics(store: str, identifier: str, folder: Folder) -> None:
    client = mlflow.MlflowClient(store)
    run = client.get_run(identifier)
    assert run.info.status == "FINISHED"
    assert run.data.params == {"model": "small", "settings.training.steps": "3"}
    assert run.data.metrics == {"parity": 1e-6, "loss": 1.0}
    assert {m.step: m.value for m in client.get_metric_history(identifier, "loss")} == {0: 2.0, 50: 1.0}
    assert run.data.tags.items() >= data_hashes(folder).items()
    assert [d.dataset.name for d in run.inputs.dataset_inputs] == ["bench-a"]


def test_files_lie_beside_the_store(store: str, identifier: str) -> None:
    client = mlflow.MlflowClient(store)
    root = Path(store.removeprefix("sqlite:///")).parent
    assert client.get_run(identifier).info.artifact_uri.startswith((root / "mlartifacts").as_uri())
    held = {path.name for path in (root / "mlartifacts").rglob("*") if path.is_file()}
    assert held >= {
        "configuration.json",
        "one.svg",
        "model.onnx",
        "model.json",
        "MLmodel",
        "requirements.txt",
    }


def test_the_model_has_the_graphs_signature_and_pinned_requirements(store: str, identifier: str) -> None:
    client = mlflow.MlflowClient(store)
    model = client.get_logged_model(client.get_run(identifier).outputs.model_outputs[0].model_id)
    assert model.name == "small"
    files = Path(model.artifact_location.removeprefix("file://"))
    info = mlflow.models.get_model_info(str(files))
    inputs = {spec.name: (spec.type, spec.shape) for spec in info.signature.inputs}
    assert inputs == {
        "volts": (np.dtype("float32"), (-1, 3, 64)),
        "elapsed_s": (np.dtype("float32"), (-1,)),
        "weight": (np.dtype("float32"), (-1, 1)),
    }
    assert [spec.shape for spec in info.signature.outputs] == [(-1, 5)]
    pins = (files / "requirements.txt").read_text().split()
    assert {pin.partition("==")[0] for pin in pins} >= {"numpy", "onnx", "onnxruntime"}
    assert all("==" in pin for pin in pins)


def test_a_run_that_breaks_off_is_marked_as_failed(store: str, identifier: str) -> None:
    with pytest.raises(KeyError), tracked("broken", {}, {}, store) as run:
        raise KeyError
    assert mlflow.MlflowClient(store).get_run(run.identifier).info.status == "FAILED"


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
    assert len(code_revision().partition("+")[0]) == 40 or code_revision() == "unknown"


def test_nested_settings_become_dotted_names() -> None:
    assert flattened({"a": {"b": {"c": 1}, "d": None}, "e": (1, 2)}) == {"a.b.c": 1, "a.d": None, "e": (1, 2)}

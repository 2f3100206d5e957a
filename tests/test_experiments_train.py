"""Training from the front door: what it learns from, what it leaves behind, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import mlflow
import numpy as np
import onnx
import pandas as pd
import pytest
from bump_slides import bump_folder, bump_sensor, lines
from front_door import call, refused

import softslide
from softslide.experiments.configuration import configured
from softslide.experiments.data_use import report_use
from softslide.experiments.provenance import bundle_hash
from softslide.experiments.tracking import find_run
from softslide.features.card import Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.models.fitted_model import FittedModel
from softslide.models.registry import model_named
from softslide.pipeline.recordings.folder import read_folder
from softslide.serve.localizer import Localizer


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    splits = {
        "calibration": lines((0.0, 90.0, 180.0, 270.0), (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0), (12.0, 20.0)),
        "test": lines((0.0, 90.0), (4.5,), (15.0,)),
    }
    return bump_folder(tmp_path_factory.mktemp("train") / "whole", bump_sensor(1), splits).root


@pytest.fixture(scope="module")
def lab(whole: Path) -> Path:
    """The same, with everything that training may not read made unreadable."""
    root = Path(shutil.copytree(whole, whole.parent / "lab"))
    for file in read_folder(root).select("test").manifest["file"]:
        (root / file).write_bytes(b"not a recording")
    return root


@pytest.fixture(scope="module")
def bundle(lab: Path) -> Path:
    out = lab.parent / "bundle"
    assert call("train", "--recordings", lab, "--model", "interpolation", "--out", out) == 0
    return out


def test_training_reads_calibration_splits_alone(bundle: Path) -> None:
    assert sorted(path.name for path in bundle.iterdir()) == ["model.json", "model.onnx"]
    assert Localizer.load(bundle).card.model == "interpolation"


def test_the_card_says_where_the_model_comes_from(bundle: Path, lab: Path) -> None:
    provenance = json.loads((bundle / "model.json").read_text())["provenance"]
    assert provenance["configuration"]["model"] == "interpolation"
    assert set(provenance["data"]) == {"sensor", "manifest", "slides"}
    assert provenance["code"]
    assert provenance["parity"] <= 1e-4


def the_run(store: str, **tags: str) -> mlflow.entities.Run:
    """The last run with these tags."""
    found = find_run(mlflow.MlflowClient(store, store), tags)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def run(bundle: Path, tracking_store: str) -> mlflow.entities.Run:
    """The bundle's training."""
    return the_run(tracking_store, bundle=bundle_hash(bundle), command="train")


def test_the_run_is_kept_with_figures_and_model(
    bundle: Path, run: mlflow.entities.Run, tracking_store: str
) -> None:
    assert run.info.run_name == "interpolation on bump"
    assert run.data.metrics["fitted_speed_percent_mean"] < 8
    assert (
        run.data.tags["data.slides"]
        == json.loads((bundle / "model.json").read_text())["provenance"]["data"]["slides"]
    )
    held = {
        path.name
        for path in (Path(tracking_store.removeprefix("sqlite:///")).parent / "mlartifacts").rglob("*")
    }
    assert held >= {"configuration.json", "fitted.html", "model.json"}


def test_a_run_repeats_from_itself(
    run: mlflow.entities.Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same bytes, with the bundle gone and its settings in no file but the run's."""
    assert call("train", "--from-run", run.info.run_id, "--out", tmp_path / "again") == 0
    assert capsys.readouterr().out.splitlines() == [
        "model.onnx: the same to the byte",
        "model.json: the same to the byte",
    ]


def test_the_configuration_of_a_run_is_one_for_training(
    run: mlflow.entities.Run, lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(mlflow.artifacts.download_artifacts(run.info.artifact_uri + "/configuration.json"))
    default = model_named("interpolation").config()
    assert (
        configured(replace(default, conditioning=Conditioning(trigger_v=1.0)), path, "interpolation")
        == default
    )
    command = ["train", "--recordings", lab, "--config", path, "--out", tmp_path / "out"]
    assert "of a run of interpolation, not cnn" in refused(capsys, *command)


def test_what_differs_is_named(
    run: mlflow.entities.Run, lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(lab, tmp_path / "lab")
    manifest = pd.read_csv(lab / "manifest.csv")
    manifest.loc[manifest["split"].str.startswith("calibration"), "speed_mm_s"] *= 1.01
    manifest.to_csv(tmp_path / "lab" / "manifest.csv", index=False)
    command = ["train", "--from-run", run.info.run_id, "--recordings", tmp_path / "lab"]
    assert call(*command, "--out", tmp_path / "again") == 1
    printed = capsys.readouterr()
    assert "not as it was: the recordings' manifest" in printed.err.splitlines()
    assert "model.onnx: differs" in printed.out.splitlines()
    assert "provenance.data.manifest" in printed.out
    assert (tmp_path / "again/model.onnx").exists()


def test_an_evaluation_is_a_run_below_its_training(
    bundle: Path, whole: Path, tracking_store: str, tmp_path: Path
) -> None:
    options = ["--split", "test", "--jobs", 1, "--out", tmp_path / "results"]
    call("evaluate", "--model", bundle, "--recordings", whole, *options)
    training, scored = (
        the_run(tracking_store, bundle=bundle_hash(bundle), command=command)
        for command in ("train", "evaluate")
    )
    assert scored.data.tags["mlflow.parentRunId"] == training.info.run_id
    assert scored.data.tags["bound.direction"] in ("met", "missed", "not tested")
    metrics = json.loads((tmp_path / "results/metrics.json").read_text())
    mean = metrics["splits"]["test"]["1.0"]["direction_deg"]["mean"]
    assert scored.data.metrics["test.direction_deg.mean"] == mean


@pytest.mark.parametrize("identifier", ["none", "0" * 32])
def test_a_run_that_does_not_exist_is_refused(
    identifier: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refused(capsys, "train", "--from-run", identifier, "--out", tmp_path / "again")
    assert f"run {identifier}: not found in sqlite" in said


def test_labels_of_other_splits_change_nothing(bundle: Path, lab: Path, tmp_path: Path) -> None:
    """The same graph, byte for byte, from a manifest whose test rows are scrambled: seeded, and blind to them."""
    shutil.copytree(lab, tmp_path / "lab")
    manifest = pd.read_csv(lab / "manifest.csv")
    rows = manifest["split"].str.startswith("test")
    manifest.loc[rows, "direction_deg"] = np.linspace(0, 300, rows.sum())
    manifest.loc[rows, "speed_mm_s"] = 7.0
    manifest.to_csv(tmp_path / "lab" / "manifest.csv", index=False)
    softslide.train(tmp_path / "lab", tmp_path / "b", "interpolation", track=False)
    assert (tmp_path / "b/model.onnx").read_bytes() == (bundle / "model.onnx").read_bytes()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--model", "oracle"], "no model 'oracle'; name one of"),
        (["--config", "none.toml"], "none.toml: no such file"),
        (["--atlas", "none.npz"], "none.npz: no such file"),
        (["--init", "none"], "none"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    assert says in refused(capsys, "train", "--recordings", lab, "--out", tmp_path / "out", *options)
    assert list(tmp_path.iterdir()) == []


def test_an_output_never_replaces_a_folder_with_other_files(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    command = ["train", "--recordings", lab, "--model", "interpolation", "--out", tmp_path]
    assert "holds other files (thesis.tex)" in refused(capsys, *command)
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def _relabelled(lab: Path, root: Path, **labels: str) -> Path:
    """A copy of the lab's folder with these labels in its first two calibration recordings, or in all for `all_`."""
    shutil.copytree(lab, root)
    table = pd.read_csv(root / "manifest.csv", dtype=str)
    calibration = table.index[table["split"].str.startswith("calibration")]
    for name, value in labels.items():
        rows = calibration if name.startswith("all_") else calibration[:2]
        table.loc[rows, name.removeprefix("all_")] = value
    table.to_csv(root / "manifest.csv", index=False)
    return root


def test_it_says_what_it_did_not_use_and_what_it_took_for_granted(
    bundle: Path, lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _relabelled(lab, tmp_path / "lab", direction_deg="", pressure_mpa="0.04")
    names = read_folder(folder).select("calibration").manifest.index
    table = pd.read_csv(folder / "manifest.csv", dtype=str).set_index("recording")
    table.loc[names[2], "depth_mm"] = ""
    table.loc[names[3:5], "pressure_mpa"] = ["0.03", "0.05"]
    table.to_csv(folder / "manifest.csv")
    assert call("train", "--recordings", folder, "--model", "interpolation", "--out", tmp_path / "out") == 0
    said = capsys.readouterr().err.splitlines()
    plan = f"training interpolation of bump from {len(names) - 4} recordings; 4 of {len(names)} left out"
    assert said[0].startswith(f"{plan}; the last interpolation on this computer took ")
    nexts = [line.removeprefix("next: ") for line in said if line.startswith("next: ")]
    assert [words.split()[1] for words in nexts] == ["evaluate", "predict", "serve"]
    assert f"learned from {len(names) - 4} of {len(names)} recordings" in said
    assert f"left out 2: no direction_deg ({names[0]}, {names[1]})" in said
    assert "no depth_mm in 1: taken as 0.5 mm" in said
    why = "pressure_mpa is 0.03 to 0.05, that of most is 0.035: a model is for one pressure"
    assert f"left out 2: {why} ({names[3]}, {names[4]})" in said


@pytest.mark.parametrize(("depth_mm", "several"), [("0.58", False), ("0.9", True)])
def test_depths_that_hardly_differ_are_one_depth(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], depth_mm: str, several: bool
) -> None:
    folder = read_folder(_relabelled(lab, tmp_path / "lab", depth_mm=depth_mm)).select("calibration")
    none = np.empty(0)
    fitted = FittedModel(
        "", "window", (), onnx.ModelProto(), lambda inputs: none, {}, Validity(), Conditioning()
    )
    report_use(folder, folder, fitted)
    said = f"depth_mm from 0.5 to {depth_mm}: any depth between them is expected"
    assert (said in capsys.readouterr().err.splitlines()) == several


def test_labels_of_which_none_can_be_used_are_refused(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _relabelled(lab, tmp_path / "lab", all_direction_deg="")
    said = refused(capsys, "train", "--recordings", folder, "--out", tmp_path / "out")
    assert "no direction_deg" in said
    assert not (tmp_path / "out").exists()

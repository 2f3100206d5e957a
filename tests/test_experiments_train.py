"""Training from the front door: what it learns from, what it leaves behind, and what it refuses."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest

import softslide
from pipeline.recordings.folder import SAMPLE, read_folder
from serve.localizer import Localizer


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample, with everything that training may not read made unreadable."""
    root = tmp_path_factory.mktemp("train") / "lab"
    shutil.copytree(SAMPLE, root)
    for file in read_folder(root).select("test").manifest["file"]:
        (root / file).write_bytes(b"not a recording")
    return root


@pytest.fixture(scope="module")
def store(lab: Path) -> str:
    return f"sqlite:///{lab.parent / 'mlflow.db'}"


@pytest.fixture(scope="module", autouse=True)
def tracking(store: str) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_TRACKING_URI", store)
        yield


@pytest.fixture(scope="module")
def bundle(lab: Path, tracking: None) -> Path:
    out = lab.parent / "bundle"
    command = ["train", "--recordings", str(lab), "--model", "interpolation", "--out", str(out)]
    assert softslide.main(command) == 0
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


def test_the_run_is_kept_with_figures_and_model(bundle: Path, store: str) -> None:
    client = mlflow.MlflowClient(store)
    run = client.search_runs(["1"], order_by=["attributes.start_time ASC"])[0]
    assert run.info.run_name == "interpolation on bench-a"
    assert run.data.metrics["fitted_speed_percent_mean"] < 8
    assert (
        run.data.tags["data.slides"]
        == json.loads((bundle / "model.json").read_text())["provenance"]["data"]["slides"]
    )
    held = {path.name for path in (Path(store.removeprefix("sqlite:///")).parent / "mlartifacts").rglob("*")}
    assert held >= {"configuration.json", "fitted.html", "MLmodel", "model.json"}


def test_labels_of_other_splits_change_nothing(bundle: Path, lab: Path, tmp_path: Path) -> None:
    """The same graph, byte for byte, from a manifest whose test rows are scrambled: seeded, and blind to them."""
    shutil.copytree(lab, tmp_path / "lab")
    manifest = pd.read_csv(lab / "manifest.csv")
    rows = manifest["split"].str.startswith("test")
    manifest.loc[rows, "direction_deg"] = np.linspace(0, 300, rows.sum())
    manifest.loc[rows, "speed_mm_s"] = 7.0
    manifest.to_csv(tmp_path / "lab" / "manifest.csv", index=False)
    command = ["train", "--recordings", tmp_path / "lab", "--model", "interpolation", "--out", tmp_path / "b"]
    assert softslide.main([str(word) for word in command]) == 0
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
    command = ["train", "--recordings", str(lab), "--out", str(tmp_path / "out"), *options]
    assert softslide.main(command) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert says in err
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_key_of_the_configuration_is_refused(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config.toml").write_text("[training]\nstepps = 3\n")
    command = ["train", "--recordings", lab, "--out", tmp_path / "out", "--config", tmp_path / "config.toml"]
    assert softslide.main([str(word) for word in command]) == 2
    assert "config.toml: training: unknown key 'stepps'" in capsys.readouterr().err


def test_an_output_never_replaces_a_folder_with_other_files(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    command = ["train", "--recordings", lab, "--model", "interpolation", "--out", tmp_path]
    assert softslide.main([str(word) for word in command]) == 2
    assert "holds other files (thesis.tex)" in capsys.readouterr().err
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def _relabelled(lab: Path, root: Path, **labels: str) -> Path:
    """A copy of the lab's folder with these labels in its first two calibration recordings, or in all for `all_`."""
    shutil.copytree(lab, root)
    table = pd.read_csv(root / "manifest.csv", dtype=str)
    taught = table.index[table["split"].str.startswith("calibration")]
    for name, value in labels.items():
        rows = taught if name.startswith("all_") else taught[:2]
        table.loc[rows, name.removeprefix("all_")] = value
    table.to_csv(root / "manifest.csv", index=False)
    return root


def test_it_says_what_it_did_not_use_and_what_it_took_for_granted(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _relabelled(lab, tmp_path / "lab", direction_deg="", pressure_mpa="0.04")
    third = read_folder(folder).select("calibration").manifest.index[2]
    table = pd.read_csv(folder / "manifest.csv", dtype=str).set_index("recording")
    table.loc[third, ["depth_mm", "pressure_mpa"]] = ["", "0.03"]
    table.to_csv(folder / "manifest.csv")
    names = read_folder(folder).select("calibration").manifest.index
    command = ["train", "--recordings", folder, "--model", "interpolation", "--out", tmp_path / "out"]
    assert softslide.main([str(word) for word in command]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert f"learnt from {len(names) - 2} of {len(names)} recordings" in lines
    assert f"left out 2: no direction_deg ({names[0]}, {names[1]})" in lines
    assert "no depth_mm in 1: taken as 0.5 mm" in lines
    assert "pressure_mpa from 0.03 to 0.035 MPa: one response map for all of them" in lines


def test_labels_of_which_none_can_be_used_are_refused(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = _relabelled(lab, tmp_path / "lab", all_direction_deg="")
    assert softslide.main(["train", "--recordings", str(folder), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "no direction_deg" in err
    assert not (tmp_path / "out").exists()

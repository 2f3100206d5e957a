"""Studies: from how few recordings, on a sensor that has drifted, and of signals that no contact makes."""

import json
from pathlib import Path

import mlflow
import pytest
from small_bundle import write_small_bundle

import softslide
from experiments.studies.few_recordings import study
from experiments.tracking.store import find_run
from pipeline.atlas.library import atlas_of
from pipeline.recordings.folder import Folder, read_folder
from pipeline.synthesis.no_contact import SIGNALS

SAMPLE = Path(__file__).parents[1] / "pipeline" / "sample"


@pytest.mark.long
def test_twelve_recordings_are_better_than_none():
    folder = read_folder(SAMPLE)
    manifest = folder.manifest
    scored = manifest.index[manifest["split"] == "test"][:4]
    taught = manifest.index[manifest["split"].str.startswith("calibration")]
    some = Folder(folder.root, folder.sensor, manifest.loc[[*taught, *scored]])
    none, twelve = study(some, [0, 12], 1, ["test"], atlas_of(folder.sensor))
    assert (none["slides"], twelve["slides"]) == (0, 12)
    assert twelve["offset_mm_mean"] < none["offset_mm_mean"] < 2.0
    assert twelve["speed_percent_mean"] < 3.0
    assert twelve["direction_deg_max"] < 6.0


def test_a_drift_s_study_is_a_run_with_one_below_it_for_each_drift(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tracking_store: str
) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", read_folder(SAMPLE).sensor)
    command = ["drift", "--model", bundle, "--recordings", SAMPLE, "--every", 9]
    assert softslide.main([str(word) for word in command]) == 0
    told = json.loads(capsys.readouterr().out)
    client = mlflow.MlflowClient(tracking_store, tracking_store)
    whole = find_run(client, {"command": "drift"}, "FINISHED")
    assert whole is not None
    below = f"tags.`mlflow.parentRunId` = '{whole.info.run_id}'"
    parts = client.search_runs([whole.info.experiment_id], below)
    assert {run.data.params["drift"]: run.data.metrics["valid"] for run in parts} == {
        name: figures["valid"] for name, figures in told.items()
    }


def test_a_study_of_false_alarms_is_a_run_with_one_below_it_for_each_signal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], tracking_store: str
) -> None:
    """The small bundle believes whatever slides."""
    bundle = write_small_bundle(tmp_path / "bundle", read_folder(SAMPLE).sensor)
    command = ["false-alarms", "--model", bundle, "--recordings", SAMPLE, "--streams", 2, "--seconds", 5]
    assert softslide.main([str(word) for word in command]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told) == list(SIGNALS)
    assert told["rest"] == {"tracked_s": 0.0, "valid_percent": None, "streams": 2, "streams_with_any": 0}
    assert told["wave"]["tracked_s"] > 1.0
    assert told["wave"]["streams_with_any"] > 0
    client = mlflow.MlflowClient(tracking_store, tracking_store)
    whole = find_run(client, {"command": "false-alarms"}, "FINISHED")
    assert whole is not None
    below = f"tags.`mlflow.parentRunId` = '{whole.info.run_id}'"
    parts = client.search_runs([whole.info.experiment_id], below)
    assert {run.data.params["signal"]: run.data.metrics["tracked_s"] for run in parts} == pytest.approx(
        {kind: found["tracked_s"] for kind, found in told.items()}, abs=1e-3
    )
    again = [str(word) for word in [*command, "--jobs", 2]]
    assert softslide.main(again) == 0
    assert json.loads(capsys.readouterr().out) == told


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["few", "--recordings", "nowhere"], "nowhere"),
        (["few", "--recordings", str(SAMPLE), "--draws", "0"], "--draws 0"),
        (["few", "--recordings", str(SAMPLE), "--split", "holiday"], "holiday"),
        (["drift", "--model", "nowhere", "--recordings", str(SAMPLE)], "nowhere"),
        (["drift", "--model", str(SAMPLE), "--recordings", str(SAMPLE), "--every", "0"], "--every 0"),
        (["drift", "--model", str(SAMPLE), "--recordings", str(SAMPLE)], "model.json"),
        (["false-alarms", "--model", "nowhere", "--recordings", str(SAMPLE)], "nowhere"),
        (
            ["false-alarms", "--model", str(SAMPLE), "--recordings", str(SAMPLE), "--streams", "0"],
            "--streams 0",
        ),
        (
            ["false-alarms", "--model", str(SAMPLE), "--recordings", str(SAMPLE), "--seconds", "nan"],
            "--seconds nan",
        ),
        (["false-alarms", "--model", str(SAMPLE), "--recordings", str(SAMPLE)], "model.json"),
    ],
)
def test_bad_input_is_one_line(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert softslide.main(words) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith(f"softslide {words[0]}: ")
    assert says in last

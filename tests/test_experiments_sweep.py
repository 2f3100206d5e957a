"""A hyperparameter search: what it may read, what it finds and keeps, and that it goes on where it was stopped."""

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path

import mlflow
import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

import softslide
from experiments.sweep.pictures import pictures
from experiments.sweep.search import _tell
from experiments.sweep.space import read_sweep
from experiments.sweep.trial import LEAST_ENDED, QUANTITIES, overall, run_trial
from features.errors import InputError
from models.registry import model_named
from pipeline.recordings.derived_labels import recordings_to_learn_from
from pipeline.recordings.folder import SAMPLE, read_folder
from pipeline.recordings.manifest import write_manifest
from serve.localizer import Localizer

PATIENCE_S = 300
CONFIG = """
model = "trees"
recordings = {recordings!r}
[budget]
trials = {trials}
workers = 2
[settings]
seed = 1
[settings.training]
recorded_share = 1.0
[space]
trees = {{ low = 2, high = 5 }}
least_leaf = [2, 12]
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's fastest calibration slides; what a sweep may not read cannot be read."""
    root = tmp_path_factory.mktemp("sweep") / "lab"
    shutil.copytree(SAMPLE, root)
    folder = read_folder(root)
    fastest = folder.select("calibration").manifest["speed_mm_s"].nlargest(12).index
    test = folder.select("test").manifest.index
    write_manifest(root / "manifest.csv", folder.manifest.loc[[*fastest, *test]])
    for file in folder.select("test").manifest["file"]:
        (root / file).write_bytes(b"not a recording")
    return root


@pytest.fixture(scope="module", autouse=True)
def store(lab: Path) -> Iterator[str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{lab.parent / 'mlflow.db'}")
        yield os.environ["MLFLOW_TRACKING_URI"]


def trials(config: Path, *states: TrialState) -> list[optuna.trial.FrozenTrial]:
    """Those of the one study in the sweep's journal."""
    storage = JournalStorage(JournalFileBackend(str(config.with_suffix(".journal"))))
    (name,) = optuna.get_all_study_names(storage)
    return optuna.load_study(study_name=name, storage=storage).get_trials(states=states or None)


@pytest.fixture(scope="module")
def stopped(lab: Path) -> tuple[Path, list[float]]:
    """A sweep that was killed after its first trial, in the middle of a line; that trial's value."""
    config = lab.parent / "trees.toml"
    config.write_text(CONFIG.format(recordings=str(lab), trials=4))
    journal = config.with_suffix(".journal")
    command = [sys.executable, str(Path(softslide.__file__)), "sweep", "--config", str(config)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, start_new_session=True) as running:
        # A trial that has ended has values in the journal.
        while not (journal.exists() and b'"values":[' in journal.read_bytes()):
            assert running.poll() is None, running.communicate()
            time.sleep(0.1)
        running.send_signal(signal.SIGKILL)
    # Its workers go with it, once they have started.
    until = time.monotonic() + PATIENCE_S
    with suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(running.pid, 0)
            time.sleep(0.1)
        pytest.fail("workers outlive the search")
    with journal.open("ab") as file:
        file.write(b'{"op_code": 6, "work')
    return config, [t.value for t in trials(config, TrialState.COMPLETE) if t.value is not None]


@pytest.fixture(scope="module")
def found(stopped: tuple[Path, list[float]], lab: Path) -> Path:
    """What the next call prints, as a file."""
    out = lab.parent / "best.toml"
    said = StringIO()
    with out.open("w") as file, redirect_stdout(file), redirect_stderr(said):
        assert softslide.main(["sweep", "--config", str(stopped[0])]) == 0
    assert "best of 4 is trial" in said.getvalue()
    return out


def test_it_goes_on_where_it_was_killed(stopped: tuple[Path, list[float]], found: Path) -> None:
    config, before = stopped
    ended = trials(config, TrialState.COMPLETE)
    assert len(before) >= 1
    assert [t.value for t in ended][: len(before)] == before
    assert len(ended) == 4
    assert trials(config, TrialState.RUNNING, TrialState.WAITING) == []
    # What was under way began again with the same settings.
    lost = [t.params for t in trials(config, TrialState.FAIL)]
    assert lost
    assert all(params in [t.params for t in ended] for params in lost)


def test_the_best_has_the_least_error_and_trains(
    stopped: tuple[Path, list[float]], found: Path, lab: Path
) -> None:
    best = min(trials(stopped[0], TrialState.COMPLETE), key=lambda t: t.value or 0.0)
    settings = tomllib.loads(found.read_text())
    assert settings["seed"] == 1
    assert settings["trees"] == best.params["trees"]
    assert str(settings["least_leaf"]) == best.params["least_leaf"]
    assert best.value == pytest.approx(overall(best.user_attrs["errors"]))
    out = lab.parent / "bundle"
    command = ["train", "--recordings", lab, "--model", "trees", "--config", found, "--out", out]
    assert softslide.main([str(word) for word in command]) == 0
    assert Localizer.load(out).card.provenance["configuration"]["settings"]["trees"] == settings["trees"]


def test_every_trial_is_a_run_below_the_sweeps(
    stopped: tuple[Path, list[float]], found: Path, store: str
) -> None:
    client = mlflow.MlflowClient(store)
    runs = client.search_runs(["1"], "tags.command = 'trial'")
    sweeps = {run.info.run_id: run for run in client.search_runs(["1"], "tags.command = 'sweep'")}
    logged = {r.data.metrics["heldout_overall"] for r in runs if r.info.status == "FINISHED"}
    assert logged == {t.value for t in trials(stopped[0], TrialState.COMPLETE)}
    assert {r.data.params["settings.seed"] for r in runs if r.info.status == "FINISHED"} == {"1"}
    assert all("data.slides" in r.data.tags for r in runs)
    assert all(run.data.tags["mlflow.parentRunId"] in sweeps for run in runs)
    (ended,) = [run for run in sweeps.values() if run.info.status == "FINISHED"]
    assert ended.data.metrics["heldout_overall"] == min(
        t.value for t in trials(stopped[0], TrialState.COMPLETE) if t.value is not None
    )
    page = stopped[0].with_suffix(".html").read_text()
    assert page.count("<svg") == 2
    assert "4 trials ended" in page
    assert "report.html" in {item.path for item in client.list_artifacts(ended.info.run_id)}
    (killed,) = [run for run in sweeps.values() if run.info.run_id != ended.info.run_id]
    assert killed.info.status == "KILLED"
    files = {item.path for item in client.list_artifacts(ended.info.run_id, "figures")}
    assert files == {"figures/history.svg", "figures/importance.svg"}


def test_a_spent_budget_tells_the_same_at_once(
    stopped: tuple[Path, list[float]], found: Path, capsys: pytest.CaptureFixture
) -> None:
    assert softslide.main(["sweep", "--config", str(stopped[0])]) == 0
    assert capsys.readouterr().out == found.read_text()
    assert len(trials(stopped[0], TrialState.COMPLETE)) == 4


def test_one_sweep_at_a_time(
    stopped: tuple[Path, list[float]], found: Path, capsys: pytest.CaptureFixture
) -> None:
    with stopped[0].with_suffix(".journal").open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert softslide.main(["sweep", "--config", str(stopped[0])]) == 2
    assert "another sweep is at work on it" in capsys.readouterr().err


def test_trials_that_all_fail_are_said(lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Two lines of four share no fold with anything to be fitted to."""
    folder = read_folder(lab)
    shutil.copytree(lab, tmp_path / "lab")
    few = folder.select("calibration").manifest.index[:1]
    write_manifest(tmp_path / "lab" / "manifest.csv", folder.manifest.loc[few])
    (tmp_path / "s.toml").write_text(CONFIG.format(recordings=str(tmp_path / "lab"), trials=1))
    assert softslide.main(["sweep", "--config", str(tmp_path / "s.toml")]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert "no trial succeeded" in error
    assert "too few lines" in error


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("[space]", "[spice]"), "unknown key 'spice'"),
        (('model = "trees"', 'model = "oracle"'), "no model 'oracle'"),
        (('model = "trees"', ""), "'model' is missing"),
        (("trees = { low = 2, high = 5 }", "tress = { low = 2, high = 5 }"), "tress: the model has no such setting"),
        (("{ low = 2, high = 5 }", "{ low = 5, high = 2 }"), "is no range"),
        (("{ low = 2, high = 5 }", "{ low = 0, high = 2, log = true }"), "is no range"),
        (("{ low = 2, high = 5 }", "{ low = 2.5, high = 5 }"), "has 2.5 for an end"),
        (("{ low = 2, high = 5 }", "{ from = 2, to = 5 }"), "write { low = 1, high = 10 }"),
        (("{ low = 2, high = 5 }", "[]"), "or a list of choices"),
        (("[2, 12]", '[2, "many"]'), "least_leaf is 'many'"),
        (("seed = 1", "sead = 1"), "settings: unknown key 'sead'"),
        (("trials = 4", "trials = 0"), "at least one trial"),
        (("[budget]", "[budget"), "not a TOML file"),
    ],
)  # fmt: skip
def test_a_bad_sweep_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture, change: tuple[str, str], says: str
) -> None:
    text = CONFIG.format(recordings="nowhere", trials=4)
    assert change[0] in text
    path = tmp_path / "s.toml"
    path.write_text(text.replace(*change))
    assert softslide.main(["sweep", "--config", str(path)]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert says in error
    assert list(tmp_path.iterdir()) == [path]


def test_nested_settings_and_lists_reach_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(
        'model = "mlp"\nrecordings = "x"\n[settings]\nconditioning.trigger_v = 0.006\n'
        "[space]\nhidden = [[16], [32, 32]]\nconditioning.release_v = { low = 0.002, high = 0.004 }\n"
    )
    plan = read_sweep(path)
    chosen = plan.configuration({"hidden": "[32, 32]", "conditioning.release_v": 0.003})
    assert chosen.hidden == (32, 32)
    assert (chosen.conditioning.trigger_v, chosen.conditioning.release_v) == (0.006, 0.003)
    with pytest.raises(InputError):
        plan.configuration({"hidden": '"wide"'})


def a_trial(value: float) -> optuna.trial.FrozenTrial:
    """One that ended, with this error from the first third of its training on."""
    return optuna.create_trial(value=value, intermediate_values={1: value, 2: value})


@pytest.mark.parametrize(("value", "thirds"), [(1e-6, [1]), (1e6, [1, 2])])
def test_a_hopeless_trial_is_given_up(value: float, thirds: list[int]) -> None:
    """A network that has learnt nothing, beside trials that were right at once, and beside others that were worse."""
    folder = recordings_to_learn_from(read_folder(SAMPLE))
    fastest = folder.manifest["speed_mm_s"].nlargest(26).index
    folder = replace(folder, manifest=folder.manifest.loc[fastest])
    default = model_named("cnn").config()
    settings = replace(
        default,
        conditioning=replace(default.conditioning, delayed=0.1),
        calibration=replace(default.calibration, iterations=1),
        training=replace(default.training, steps=6, batch=8),
    )
    outcome = run_trial("cnn", folder, settings, None, [a_trial(value)] * LEAST_ENDED)
    assert list(outcome.so_far) == thirds
    assert set(outcome.errors) == (set() if len(thirds) == 1 else set(QUANTITIES))
    study = optuna.create_study()
    future: Future = Future()
    future.set_result(outcome)
    told = _tell(study, study.ask(), future)
    assert told.state is (TrialState.PRUNED if len(thirds) == 1 else TrialState.COMPLETE)
    assert told.intermediate_values == outcome.so_far
    assert "<svg" in pictures(study)["history"] if outcome.errors else told.value == outcome.so_far[1]


def test_a_share_off_any_error_counts_alike() -> None:
    errors = {"direction_deg": 0.5, "speed_percent": 2.0, "offset_mm": 0.1}
    better = {overall(errors | {name: 0.9 * error}) for name, error in errors.items()}
    assert max(better) == pytest.approx(min(better))
    assert max(better) < overall(errors)

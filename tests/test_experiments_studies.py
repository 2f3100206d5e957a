"""The studies' scripts on small worlds: their figures' shape and laws, `--json`, and wrong input in one line."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import optuna
import pytest
from front_door import call
from sample_folder import sample_folder
from small_bundle import write_small_bundle
from streams import RATE_HZ, a_sensor, pass_over, still, stream
from touched_bundle import write_touched_bundle
from touched_skin import write_skin

from softslide.experiments.studies import (
    changed_slides,
    decision_time,
    false_alarms,
    feature_speed,
    few_recordings,
    motion_noise,
    partial_contact,
    skin_sensitivity,
    skin_speed,
    slide_changes,
    slides_needed,
    sweep,
    tracker_constants,
)
from softslide.experiments.studies.skin_changes import CHANGES, DEPTH_MM, HEIGHT_MM, changed
from softslide.features.card import read_card
from softslide.features.contact.tracking_config import TrackingConfig
from softslide.features.stream.conditioning import Conditioning
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, read_atlas
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder
from softslide.pipeline.recordings.manifest import write_manifest
from softslide.pipeline.sensor import check_design, read_sensor
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.no_contact import OF_ACCELEROMETERS, SIGNALS
from softslide.pipeline.synthesis.paths.draw import draw_path
from softslide.pipeline.synthesis.specimen import draw_specimen
from softslide.pipeline.synthesis.synthesize import noise_of, record, sensor_of

SCRIPTS = (changed_slides, decision_time, false_alarms, feature_speed, few_recordings, motion_noise)
SCRIPTS += (partial_contact, skin_sensitivity, skin_speed, slides_needed, sweep, tracker_constants)
ALONG = np.arange(-25.0, 25.0 + skin_sensitivity.STEP_MM / 2, skin_sensitivity.STEP_MM)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Believes whatever slides."""
    return write_small_bundle(tmp_path_factory.mktemp("small") / "bundle", read_folder(SAMPLE).sensor)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's fastest calibration slides, and test slides that cannot be read."""
    root = tmp_path_factory.mktemp("sweep") / "lab"
    shutil.copytree(SAMPLE, root)
    folder = read_folder(root)
    fastest = folder.select("calibration").manifest["speed_mm_s"].nlargest(12).index
    test = folder.select("test").manifest
    write_manifest(root / "manifest.csv", folder.manifest.loc[[*fastest, *test.index]])
    for file in test["file"]:
        (root / file).write_bytes(b"not a recording")
    return root


def figures_of(script, folder: Path, *words: object) -> dict:
    """What a script writes to --json."""
    assert script.main([*map(str, words), "--json", str(folder / "found.json")]) == 0
    return json.loads((folder / "found.json").read_text())


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.__name__)
def test_help_has_an_example_that_names_the_script(script, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        script.main(["--help"])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert f"    python -m {script.__name__}" in shown or f"1 python -m {script.__name__}" in shown
    assert "--json FILE" in shown


@pytest.mark.parametrize(
    ("script", "words", "says"),
    [
        (few_recordings, ["--recordings", "nowhere"], "nowhere"),
        (few_recordings, ["--recordings", SAMPLE, "--split", "holiday"], "holiday"),
        (few_recordings, ["--recordings", SAMPLE, "--plan", SAMPLE / "manifest.csv"], "not a calibration slide"),
        (changed_slides, ["--model", "nowhere", "--recordings", SAMPLE], "nowhere"),
        (changed_slides, ["--model", SAMPLE, "--recordings", SAMPLE], "model.json"),
        (false_alarms, ["--model", SAMPLE, "--recordings", SAMPLE], "model.json"),
        (motion_noise, ["--model", SAMPLE, "--recordings", SAMPLE], "model.json"),
        (decision_time, ["--model", SAMPLE, "--slides", "slide.csv"], "model.json"),
        (sweep, ["--recordings", "nowhere", "--out", "best.toml"], "nowhere"),
        (tracker_constants, ["--recordings", SAMPLE, "--json", "no/where.json"], "no such folder"),
    ],
)  # fmt: skip
def test_wrong_input_is_one_line(script, words: list, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert script.main([str(word) for word in words]) == 2
    *_, line = capsys.readouterr().err.splitlines()
    assert line.startswith(f"python -m {script.__name__}: ")
    assert says in line


def test_a_number_that_is_too_small_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        few_recordings.main(["--recordings", str(SAMPLE), "--slides", "-1"])
    assert ended.value.code == 2
    assert "-1: give 0 or more" in capsys.readouterr().err


def test_changes_that_keep_the_signal_keep_the_estimates(bundle: Path, tmp_path: Path) -> None:
    """The small bundle's direction and speed are constants, so that errors are those of the sample's labels."""
    fast = sample_folder(tmp_path / "fast", "split == 'test-fast'")
    words = ("--model", bundle, "--recordings", fast, "--every", 3, "--jobs", 1)
    figures = figures_of(changed_slides, tmp_path, *words)
    assert list(figures) == [*slide_changes.CHANGES, changed_slides.LATE]
    assert figures["none"]["valid"] > 0
    for name in ("zero + 50 mV", "mounted at 3 deg"):
        assert figures[name]["direction_deg"] == pytest.approx(figures["none"]["direction_deg"]), name
    assert figures["mounted at 180 deg"]["valid"] == 0


def test_a_change_of_attitude_keeps_gravity_and_turns_it_by_its_angle() -> None:
    sensor = read_folder(SAMPLE).sensor
    board = sensor.accelerometers[0]
    level = board.zero_g_v + board.sensitivity_v_per_g * np.array([[0.0, 0.0, 1.0]])
    turned = slide_changes.changed("mounted at 20 deg", level, level[0], np.zeros(1), sensor)
    gravity = (turned[0] - board.zero_g_v) / board.sensitivity_v_per_g
    assert np.linalg.norm(gravity) == pytest.approx(1.0)
    assert np.degrees(np.arccos(gravity[2])) == pytest.approx(20.0)


def test_false_alarms_are_counted_by_signal_and_alike_on_two_processes(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--model", bundle, "--recordings", SAMPLE, "--streams", 2, "--seconds", 3)
    figures = figures_of(false_alarms, tmp_path, *words)
    assert list(figures) == list(SIGNALS)
    assert figures["rest"] == {"tracked_s": 0.0, "valid_percent": None, "streams": 2, "streams_with_any": 0}
    assert figures["wave"]["tracked_s"] > 1.0
    assert figures["wave"]["streams_with_any"] > 0
    printed = capsys.readouterr().out
    assert figures_of(false_alarms, tmp_path, *words, "--jobs", 2) == figures
    assert capsys.readouterr().out == printed


def test_of_a_skin_without_accelerometers_the_outputs_are_disturbed_and_none_is_followed(
    tmp_path: Path,
) -> None:
    folder, bundle = write_skin(tmp_path / "skin", 1, 0), write_touched_bundle(tmp_path / "bundle")
    figures = dict(false_alarms.false_alarms(bundle, folder, streams=3, seconds=8.0))
    assert list(figures) == [kind for kind in SIGNALS if kind not in OF_ACCELEROMETERS]
    tracked_s = [found["tracked_s"] for found in figures.values()]
    assert sum(tracked_s) > 60.0
    valid_percent = np.nan_to_num([found["valid_percent"] for found in figures.values()])
    assert valid_percent @ tracked_s <= 0.5 * sum(tracked_s)


@pytest.mark.long
def test_twelve_recordings_are_better_than_none() -> None:
    folder = read_folder(SAMPLE)
    manifest = folder.manifest
    scored = manifest.index[manifest["split"] == "test"][:4]
    learned = manifest.index[manifest["split"].str.startswith("calibration")]
    some = Folder(folder.root, folder.sensor, manifest.loc[[*learned, *scored]])
    figures = dict(few_recordings.few(some, [0, 12], 1, ["test"]))
    assert list(figures) == ["0", "12"]
    assert figures["12"]["offset_mm"] < figures["0"]["offset_mm"] < 2.0
    assert figures["12"]["speed_percent"] < 3.0
    assert figures["12"]["direction_deg_max"] < 6.0


def test_an_extreme_is_found_between_the_samples() -> None:
    assert skin_sensitivity.extreme(ALONG, -((ALONG - 7.3) ** 2)) == pytest.approx(7.3)


def test_the_width_of_a_bell_is_its_deviation_over_root_two() -> None:
    """The square of exp(-x^2 / (2 s^2)) has the variance s^2 / 2."""
    bell = np.exp(-((ALONG - 1.0) ** 2) / (2 * 5.0**2))
    assert skin_sensitivity.width(ALONG, bell) == pytest.approx(5.0 / np.sqrt(2), rel=1e-3)


def test_every_change_gives_a_design_of_its_own() -> None:
    seen = [changed(read_sensor(DEFAULT_SENSOR), part, values) for _, part, values in CHANGES]
    for (name, _, _), (sensor, _, _) in zip(CHANGES, seen, strict=True):
        check_design(sensor, name)
    assert len(set(seen)) == len({name for name, _, _ in CHANGES}) == len(CHANGES)


@pytest.mark.long
def test_friction_separates_forth_from_back(tmp_path: Path) -> None:
    """On a coarse mesh."""
    sensor = read_sensor(DEFAULT_SENSOR)
    coarse = replace(sensor, mesh=replace(sensor.mesh, size_mm=5.0))
    rows = {
        name: skin_sensitivity.figures(
            replace(coarse, skin=replace(sensor.skin, friction=f)), HEIGHT_MM, DEPTH_MM
        )
        for name, f in (("design", 0.0), ("friction 0.4", 0.4))
    }
    without, rubbing = rows.values()
    assert set(without) == set(skin_sensitivity.SHOWN)
    assert abs(without["hysteresis_mm"]) < 0.1
    assert rubbing["hysteresis_mm"] > 0.5
    assert without["static_deg"] == rubbing["static_deg"] > 5.0
    for row in rows.values():
        assert 10.0 < row["extremes_mm"] < 22.0
    skin_sensitivity.draw(rows, tmp_path / "study.svg")
    assert (tmp_path / "study.svg").read_text().startswith("<?xml")


def test_a_tracker_that_needs_twice_as_much_sees_no_more_presses() -> None:
    folder = read_folder(SAMPLE).select("calibration")
    some = replace(folder, manifest=folder.manifest.nlargest(8, "speed_mm_s"))
    streams = {"slides": [], **tracker_constants.streams_of(some, Conditioning())}
    assert {kind: len(of) for kind, of in streams.items()} == {
        "slides": 2,
        "jumps": 2,
        "presses": 20,
        "stops": 20,
    }
    figures = tracker_constants.score(streams, Conditioning())
    assert figures["slides_lost"] == 0
    assert 0 < figures["slides_seen_in_presses"] < 20
    deaf = tracker_constants.score(streams, replace(Conditioning(), trigger_v=10.0, release_v=9.0))
    assert (deaf["slides_lost"], deaf["slides_seen_in_presses"]) == (2, 0)


def test_the_law_of_a_press_fits_itself() -> None:
    depth = np.linspace(-6.0, 0.2, 30)
    way = np.clip((depth + 5.0) / 5.2, 0, 1)
    tilt = way[:, None] ** 1.3 * np.array([0.1, -0.05])
    press = partial_contact.Press((3.0, 4.0), 7.0, depth, tilt, -5.0)
    np.testing.assert_allclose(press.law_g(1.3), tilt, atol=1e-12)
    found = partial_contact.fitted(
        [press, replace(press, place_mm=(12.0, -9.0))], read_sensor(DEFAULT_SENSOR)
    )
    assert found["exponent"] == pytest.approx(1.3, abs=1e-3)


def test_features_in_batches_of_bins_cost_least(tmp_path: Path) -> None:
    figures = figures_of(feature_speed, tmp_path)
    assert 0 < figures["features_ms"] < figures["features_of_all_samples_ms"]
    assert figures["features_ms"] < figures["features_one_window_at_a_time_ms"]


def test_synthetic_signal_is_faster_than_real_time() -> None:
    assert dict(skin_speed.synthetic_signal(4))["synthetic_times_real_time"] > 1.0


@pytest.mark.parametrize("accelerometers", [1, 2])
def test_a_decision_s_time_has_its_unit(tmp_path: Path, accelerometers: int) -> None:
    place = write_small_bundle(tmp_path / "b", a_sensor(accelerometers))
    volts = stream(still(2.0), pass_over(3.0), still(1.0), accelerometers=accelerometers)
    columns = ["time_s", *a_sensor(accelerometers).channels]
    table = np.column_stack([np.arange(len(volts)) / RATE_HZ, volts])
    np.savetxt(slide := tmp_path / "s.csv", table, delimiter=",", header=",".join(columns), comments="")
    figures = dict(decision_time.costs(place, [slide], 20))
    for name in ("decision_at_rest", "decision_in_a_slide", "inference_alone"):
        assert 0 < figures[name]["median_us"] <= figures[name]["p99_us"]
        assert figures[name]["mean_us"] > 0
        assert figures[name]["p99_ratio"] >= 1
        assert figures[name]["ratio"] > 0
    assert figures["bundle_kb"] == sum(path.stat().st_size for path in place.iterdir()) / 1e3
    assert figures["first_estimate_s"] > 0


def test_a_sweep_never_reads_test_slides_and_its_best_trains(
    lab: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second call goes on with the trials of the first."""
    few = {"trees": 2, "least_leaf": 2, "training": {"recorded_share": 1.0}}

    def settings(trial: optuna.Trial) -> dict:
        return few | {"least_leaf": trial.suggest_int("least_leaf", 2, 12)}

    monkeypatch.setitem(sweep.SETTINGS, "trees", settings)
    out, storage = tmp_path / "best.toml", f"sqlite:///{tmp_path / 'sweep.db'}"
    words = ["--recordings", lab, "--model", "trees", "--trials", 1, "--storage", storage, "--out", out]
    trials: dict[str, dict[str, float]] = {}
    for _ in range(2):
        trials |= figures_of(sweep, tmp_path, *words)
    assert list(trials) == [f"trial {n}" for n in range(2)]
    best = min(trials.values(), key=lambda trial: trial["overall"])
    errors = [best[name] for name in ("direction_deg", "speed_percent", "offset_mm")]
    assert best["overall"] == pytest.approx(np.prod(errors) ** (1 / 3), rel=1e-3)
    assert tomllib.loads(out.read_text()) == few | {"least_leaf": best["least_leaf"]}
    command = ["train", "--recordings", lab, "--model", "trees", "--config", out]
    assert call(*command, "--out", tmp_path / "bundle") == 0


def test_settings_of_a_sweep_are_a_models_own() -> None:
    from softslide.models.registry import model_named
    from softslide.pipeline.toml_tables import changed as configured

    for model, settings in sweep.SETTINGS.items():
        table = settings(optuna.create_study().ask())
        assert configured(model_named(model).config(), table, "sweep") != model_named(model).config()


def test_a_hopeless_trial_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """After five that ended at a third of its error."""
    ended = {"heldout_direction_deg": 1.0, "heldout_log_speed": 0.01, "heldout_offset_mm": 0.1}
    study = optuna.create_study(pruner=sweep.PRUNERS["median"])
    worse = iter([1.0] * 5 + [3.0])

    def fit(model, folder, config, given):
        times = next(worse)
        given.judge(1, {name: times * error for name, error in ended.items()})
        return type("Fitted", (), {"summary": ended})

    monkeypatch.setattr(sweep, "fit_model", fit)
    monkeypatch.setattr(sweep, "design_for", lambda *_: None)
    *five, (name, last) = sweep.sweep(study, "cnn", read_folder(SAMPLE), 6)
    assert [found["overall"] for _, found in five] == pytest.approx([0.1 ** (1 / 3)] * 5)
    assert name == "trial 5"
    assert np.isnan(last["overall"])
    assert study.trials[-1].state is optuna.trial.TrialState.PRUNED


def test_a_path_that_changes_speed_gains_by_noises_that_let_it() -> None:
    card = read_card(Path(__file__).parents[1] / "docs" / "examples" / "bundle" / "model.json")
    atlas = read_atlas()
    drawn = draw_path(0, atlas, sensor_of(atlas), Distribution(), np.random.default_rng(3), kind="speed")
    specimen = draw_specimen(sensor_of(atlas), Distribution(stopping=0.3), 301)
    blocks = motion_noise.blocks_of(record(drawn, specimen, atlas, noise_of(0, 0)).volts, card)
    config = TrackingConfig()
    worth = motion_noise.gained(blocks, card, config)
    stiff = replace(config.noise, speed=0.001, acceleration=0.0001)
    held = replace(config.manoeuvres, steering=(1e-9, 1e-9, 1e-9))
    assert worth > motion_noise.gained(blocks, card, replace(config, noise=stiff, manoeuvres=held))
    assert worth == motion_noise.gained(blocks, card, config)
    assert {name for part, name in motion_noise.numbers(config)} >= {"speed", "stop", "lift"}

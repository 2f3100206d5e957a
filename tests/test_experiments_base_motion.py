"""From recordings on a robot that moves to estimates there: train, evaluate, predict, recalibrate, import."""

import io
import json
from collections.abc import Iterator
from contextlib import redirect_stderr
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from front_door import call, refused
from moving_robot import BASE, felt_g, on_a_robot, wandering
from sample_folder import sample_folder

import softslide
from softslide.experiments.data_use import report_base
from softslide.features.units import STANDARD_GRAVITY
from softslide.pipeline.checks.report import checked
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.folder import SAMPLE, Folder, Recording, read_folder, write_folder
from softslide.pipeline.sensor import write_sensor
from softslide.serve.localizer import Localizer


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The sample's slides that take less than 30 s."""
    return read_folder(sample_folder(tmp_path_factory.mktemp("sample"), "speed_mm_s >= 2"))


@pytest.fixture(scope="module")
def lab(sample: Folder, tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Its calibration slides on a table, its test slides on a robot that moves, and the robot alone."""
    rate = sample.sensor.sample_rate_hz
    names = [str(name) for name in sample.manifest.index]

    def moved(name: str, volts: np.ndarray, tilt_deg: float, seed: int) -> Recording:
        felt = wandering(len(volts), rate, tilt_deg, 0.001 * tilt_deg, seed)
        samples = on_a_robot(volts, sample.sensor, felt, seed)
        return Recording(name, np.arange(len(volts)) / rate, samples[:, :-3], base_v=samples[:, -3:])

    def recordings() -> Iterator[Recording]:
        for seed, name in enumerate(names):
            still = sample.manifest.at[name, "split"].startswith("calibration")
            yield moved(name, sample.load(name).volts, 0.0 if still else 15.0, seed)
        first = sample.load(names[0])
        quiet = first.volts[first.time_s < sample.manifest.at[names[0], "motion_start_s"] - 0.2]
        drawn = np.random.default_rng(0).integers(0, len(quiet), round(60 * rate))
        yield moved("robot", quiet[drawn], 20.0, 1000)

    robot = pd.DataFrame({"split": ["base"]}, index=pd.Index(["robot"], name="recording"))
    manifest = pd.concat([sample.manifest.drop(columns="file"), robot])
    sensor = replace(sample.sensor, base=BASE)
    return write_folder(tmp_path_factory.mktemp("robot") / "lab", sensor, manifest, recordings())


@pytest.fixture(scope="module")
def trained(lab: Folder) -> tuple[Path, str]:
    """A bundle, and what `train` said."""
    out, said = lab.root.parent / "bundle", io.StringIO()
    with redirect_stderr(said):
        softslide.train(lab.root, out, "interpolation", track=False)
    return out, said.getvalue()


@pytest.fixture(scope="module")
def bundle(trained: tuple[Path, str]) -> Path:
    return trained[0]


def evaluated(bundle: Path, recordings: Path, out: Path) -> dict:
    call("evaluate", "--model", bundle, "--recordings", recordings, "--out", out)
    return json.loads((out / "metrics.json").read_text())["overall"]["1.0"]


def test_the_bundle_knows_how_the_skin_follows_the_base(bundle: Path, lab: Folder) -> None:
    base = Localizer.load(bundle).card.base
    assert base is not None
    assert np.linalg.norm(np.array(base.gains), axis=0) == pytest.approx(0.8 / 0.5, rel=0.02)


def test_training_says_how_far_the_base_moved_and_what_is_left(trained: tuple[Path, str]) -> None:
    line = next(line for line in trained[1].splitlines() if line.startswith("the base moved"))
    before, left = (float(words.split()[-1]) for words in line.split(" mV")[:2])
    assert before > 50
    assert left < 4


@pytest.mark.parametrize(("late_s", "shows"), [(0.0, False), (0.03, True)])
def test_a_base_that_comes_late_is_reported(
    lab: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str], late_s: float, shows: bool
) -> None:
    robot = lab.load("robot")
    assert robot.base_v is not None
    shifted = np.roll(robot.base_v, round(late_s * lab.sensor.sample_rate_hz), axis=0)
    folder = write_folder(
        tmp_path / "lab", lab.sensor, lab.manifest.loc[["robot"]], [replace(robot, base_v=shifted)]
    )
    report_base(without_base_motion(folder))
    assert ("are both sampled at the same time" in capsys.readouterr().err) == shows


@pytest.mark.long
def test_estimates_on_a_moving_robot_are_those_on_a_table(
    bundle: Path, sample: Folder, lab: Folder, tmp_path: Path
) -> None:
    plain = tmp_path / "plain"
    assert call("train", "--recordings", sample.root, "--model", "interpolation", "--out", plain) == 0
    table = evaluated(plain, sample.root, tmp_path / "table")
    robot = evaluated(bundle, lab.root, tmp_path / "robot")
    without = evaluated(plain, lab.root, tmp_path / "without")
    assert robot["valid_share"] == table["valid_share"]
    for name, allowance in (("direction_deg", 1.0), ("speed_percent", 1.5), ("offset_mm", 0.1)):
        assert robot[name]["mean"] <= table[name]["mean"] + allowance
    # Hardly a contact can be known from the robot's motion.
    assert without["valid_share"] < 0.5 * table["valid_share"]


def test_a_folder_without_a_base_is_refused(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["evaluate", "--model", bundle, "--recordings", SAMPLE, "--out", tmp_path / "out"]
    assert "has no [base], which the bundle reads" in refused(capsys, *words)


def test_an_imu_comes_in_as_volts(tmp_path: Path) -> None:
    sensor = replace(read_folder(SAMPLE).sensor, base=BASE)
    rate = sensor.sample_rate_hz
    felt = felt_g(np.linspace(0.0, 20.0, 500), np.linspace(5.0, -5.0, 500))
    outputs = ("a0_vx", "a0_vy", "a0_vz", "base_vx", "base_vy", "base_vz")
    table = np.column_stack([np.arange(500) / rate, 1.65 + 0.8 * felt, STANDARD_GRAVITY * felt])
    (tmp_path / "lab").mkdir()
    pd.DataFrame(table, columns=["t", *outputs]).to_csv(tmp_path / "lab" / "one.csv", index=False)
    write_sensor(tmp_path / "sensor.toml", sensor)
    maps = [
        f'[channels.{name}]\ncolumn = "{name}"\nunit = "{"m/s2" if name.startswith("base") else "V"}"\n'
        for name in outputs
    ]
    head = (
        'kind = "csv"\nsensor = "sensor.toml"\npattern = "(?P<recording>[a-z]+)"\n[time]\ncolumn = "t"\n'
        '[labels.recording]\nname = "recording"\n[labels.split]\nvalue = "base"\n'
    )
    (tmp_path / "map.toml").write_text(head + "".join(maps))
    assert call("import", tmp_path / "lab", "--map", tmp_path / "map.toml", "--out", tmp_path / "out") == 0
    recording = read_folder(tmp_path / "out").load("one")
    assert recording.base_v == pytest.approx(BASE.zero_g_v + BASE.sensitivity_v_per_g * felt)
    assert recording.volts == pytest.approx(1.65 + 0.8 * felt)


def test_check_sees_the_slides_and_not_the_robot(lab: Folder) -> None:
    assert [finding.line() for finding in checked(lab).findings if finding.level == "error"] == []


def test_check_asks_for_a_recording_of_the_robot_s_motion(lab: Folder) -> None:
    found = checked(replace(lab, manifest=lab.manifest.drop("robot"))).findings
    assert [finding.kind for finding in found if "record a minute" in finding.text] == ["base"]

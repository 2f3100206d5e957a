"""The runtime on a robot that moves: with a base's accelerometer it sees contacts and nothing else."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from moving_robot import BASE, exact_motion, felt_g, on_a_robot, wandering
from small_bundle import write_small_bundle
from streams import RATE_HZ, a_sensor, pass_over, still, stream

import softslide
from features.card import read_card, write_card
from features.errors import InputError
from features.estimate import Reason
from features.stream.tracker import SlideState
from serve.localizer import Localizer

SENSOR = replace(a_sensor(), base=BASE)
TABLE = stream(still(1.0), pass_over(3.0), still(0.8))
CHANNELS = ("time_s", "a0_vx", "a0_vy", "a0_vz", "base_vx", "base_vy", "base_vz")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_small_bundle(tmp_path_factory.mktemp("bundles") / "one", SENSOR, offset_mm_per_v=50.0)
    card = read_card(folder / "model.json")
    write_card(replace(card, base=exact_motion(SENSOR)), folder / "model.json")
    return folder


@pytest.fixture(scope="module")
def localizer(bundle: Path) -> Localizer:
    return Localizer.load(bundle)


def moving(volts: np.ndarray, tilt_deg: float = 20.0, seed: int = 0) -> np.ndarray:
    return on_a_robot(volts, SENSOR, wandering(len(volts), RATE_HZ, tilt_deg, seed=seed), seed)


def test_the_card_keeps_how_the_skin_follows_the_base(bundle: Path) -> None:
    card = read_card(bundle / "model.json")
    assert card.base == exact_motion(SENSOR)
    assert card.columns == CHANNELS[1:]


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_moves_is_no_contact(localizer: Localizer, seed: int) -> None:
    samples = moving(stream(still(20.0)), seed=seed)
    localizer.reset()
    assert {e.state for e in localizer.push(samples)} == {SlideState.REST}


def test_without_its_base_the_same_motion_is_taken_for_contacts(tmp_path: Path) -> None:
    plain = Localizer.load(write_small_bundle(tmp_path / "plain", replace(SENSOR, base=None)))
    states = {e.state for e in plain.push(moving(stream(still(20.0)))[:, :3])}
    assert SlideState.SLIDE in states


@pytest.mark.parametrize("seed", range(3))
def test_a_slide_on_a_moving_robot_is_told_as_on_a_table(localizer: Localizer, seed: int) -> None:
    level = np.tile([0.0, 0.0, 1.0], (len(TABLE), 1))
    told = []
    for samples in (on_a_robot(TABLE, SENSOR, level), moving(TABLE, seed=seed)):
        localizer.reset()
        localizer.feed(samples)
        told.append((localizer.read(), localizer.window()))
    (table, still_window), (robot, moved_window) = told
    assert table.valid
    assert robot.valid
    assert still_window is not None
    assert moved_window is not None
    assert moved_window.elapsed_s == pytest.approx(still_window.elapsed_s, abs=0.1)
    assert robot.offset_mm == pytest.approx(table.offset_mm, abs=0.3)


def test_estimates_do_not_depend_on_the_chunks(localizer: Localizer) -> None:
    samples = moving(TABLE)
    localizer.reset()
    whole = [repr(e) for e in localizer.push(samples)]
    localizer.reset()
    cuts = [0, 7, 33, 1000, 1001, 2500, len(samples)]
    pieces = [repr(e) for begin, end in pairwise(cuts) for e in localizer.push(samples[begin:end])]
    assert pieces == whole


@pytest.mark.parametrize("fault", [np.nan, 0.0, 3.0, 1.5])
def test_without_the_base_nothing_is_valid(localizer: Localizer, fault: float) -> None:
    """Lost, at an end of the supply, or frozen: what the skin shows may be the robot's motion."""
    samples = moving(TABLE)
    samples[500:, 4] = fault
    localizer.reset()
    estimates = localizer.push(samples)[60:]
    assert not any(e.valid for e in estimates)
    assert {e.reason for e in estimates if e.time_s > 1.5} == {Reason.DEAD_CHANNEL}


def test_a_robot_on_its_side_tells_nothing(localizer: Localizer) -> None:
    quiet = stream(still(3.0))
    over = felt_g(np.linspace(0.0, 80.0, len(quiet)), np.zeros(len(quiet)))
    localizer.reset()
    last = localizer.push(on_a_robot(quiet, SENSOR, over))[-1]
    assert not last.valid
    assert last.reason is Reason.DEAD_CHANNEL


def test_samples_without_the_base_s_columns_are_refused(localizer: Localizer) -> None:
    with pytest.raises(InputError, match=re.escape("push (n, 6) volts")):
        localizer.push(TABLE)


def test_predict_names_the_column_that_is_missing(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    samples = np.column_stack([np.arange(len(TABLE)) / RATE_HZ, moving(TABLE)])
    for width, name in ((7, "whole"), (4, "skin")):
        np.savetxt(
            tmp_path / f"{name}.csv",
            samples[:, :width],
            delimiter=",",
            header=",".join(CHANNELS[:width]),
            comments="",
        )
    words = ["predict", "--model", str(bundle)]
    assert softslide.main([*words, str(tmp_path / "whole.csv")]) == 0
    assert '"valid": true' in capsys.readouterr().out
    assert softslide.main([*words, str(tmp_path / "skin.csv")]) == 2
    assert "column 'base_vx' is missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"base": None}, "sensor: base is no table"),
        ({"base": {"sensitivity_v_per_g": 0.8}}, "sensor: base: zero_g_v"),
    ],
)
def test_a_card_whose_sensor_has_no_such_base_is_refused(bundle: Path, change: dict, said: str) -> None:
    card = read_card(bundle / "model.json")
    with pytest.raises(ValueError, match=said):
        replace(card, sensor={**card.sensor, **change})


def test_gains_of_another_sensor_are_refused(bundle: Path) -> None:
    card = read_card(bundle / "model.json")
    with pytest.raises(ValueError, match="6 rows of gains for 3 channels"):
        replace(card, base=exact_motion(a_sensor(2)))

"""The runtime on a robot that moves: with a base's accelerometer it sees contacts and nothing else."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from moving_robot import BASE, exact_motion, felt_g, on_a_robot, wandering
from small_bundle import write_small_bundle
from streams import RATE_HZ, a_sensor, pass_over, pushed, still, stream, write_csv

import softslide
from softslide.features.card import read_card, write_card
from softslide.features.errors import InputError
from softslide.features.estimate import Reason
from softslide.features.stream.tracker import SlideState
from softslide.serve.localizer import Localizer

SENSOR = replace(a_sensor(), base=BASE)
EXACT = exact_motion(SENSOR)
TABLE = stream(still(1.0), pass_over(3.0), still(0.8))
CHANNELS = ("a0_vx", "a0_vy", "a0_vz", "base_vx", "base_vy", "base_vz")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_small_bundle(tmp_path_factory.mktemp("bundles") / "one", SENSOR, offset_mm_per_v=50.0)
    card = read_card(folder / "model.json")
    write_card(replace(card, base=EXACT), folder / "model.json")
    return folder


@pytest.fixture(scope="module")
def localizer(bundle: Path) -> Localizer:
    return Localizer.load(bundle)


def moving(volts: np.ndarray, seed: int = 0) -> np.ndarray:
    return on_a_robot(volts, SENSOR, wandering(len(volts), RATE_HZ, 20.0, seed=seed), seed)


def test_without_its_base_the_same_motion_is_taken_for_contacts(tmp_path: Path) -> None:
    plain = Localizer.load(write_small_bundle(tmp_path / "plain", replace(SENSOR, base=None)))
    states = {e.state for e in plain.push(moving(stream(still(20.0)))[:, :3])}
    assert SlideState.SLIDE in states


@pytest.mark.parametrize("seed", range(3))
def test_a_slide_on_a_moving_robot_is_as_on_a_table_and_its_motion_is_not_a_contact(
    localizer: Localizer, seed: int
) -> None:
    level = np.tile([0.0, 0.0, 1.0], (len(TABLE), 1))
    found = []
    for samples in (on_a_robot(TABLE, SENSOR, level), moving(TABLE, seed=seed)):
        localizer.reset()
        localizer.feed(samples)
        window = localizer.window()
        assert window is not None
        assert localizer.read().valid
        found.append((localizer.read().offset_mm, window.elapsed_s))
    (table_mm, table_s), (robot_mm, robot_s) = found
    assert robot_s == pytest.approx(table_s, abs=0.1)
    assert robot_mm == pytest.approx(table_mm, abs=0.3)
    estimates = pushed(localizer, moving(stream(still(20.0)), seed=seed))
    assert {e.state for e in estimates} == {SlideState.REST}


def test_estimates_do_not_depend_on_the_chunks(localizer: Localizer) -> None:
    samples = moving(TABLE)
    whole = [repr(e) for e in pushed(localizer, samples)]
    localizer.reset()
    chunks = np.split(samples, [7, 33, 1000, 1001, 2500])
    assert [repr(e) for chunk in chunks for e in localizer.push(chunk)] == whole


@pytest.mark.parametrize("fault", [np.nan, 0.0, 3.0, 1.5])
def test_without_the_base_nothing_is_valid(localizer: Localizer, fault: float) -> None:
    """Lost, at an end of the supply, or frozen: what the skin shows may be the robot's motion."""
    samples = moving(TABLE)
    samples[500:, 4] = fault
    estimates = pushed(localizer, samples)[60:]
    assert not any(e.valid for e in estimates)
    assert {e.reason for e in estimates if e.time_s > 1.5} == {Reason.DEAD_CHANNEL}


def test_nothing_is_valid_on_a_robot_on_its_side(localizer: Localizer) -> None:
    quiet = stream(still(3.0))
    over = felt_g(np.linspace(0.0, 80.0, len(quiet)), np.zeros(len(quiet)))
    last = pushed(localizer, on_a_robot(quiet, SENSOR, over))[-1]
    assert (last.valid, last.reason) == (False, Reason.DEAD_CHANNEL)


def test_samples_without_the_base_s_columns_are_refused(
    localizer: Localizer, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(InputError, match=re.escape("push (n, 6) volts")):
        localizer.push(TABLE)
    said = []
    for width, status in ((6, 0), (3, 2)):
        path = write_csv(tmp_path / f"{width}.csv", moving(TABLE)[:, :width], CHANNELS[:width])
        assert softslide.main(["predict", "--model", str(bundle), str(path)]) == status
        said.append(capsys.readouterr())
    assert '"valid": true' in said[0].out
    assert "column 'base_vx' is missing" in said[1].err


def test_a_card_without_such_a_base_or_of_another_sensor_is_refused(bundle: Path) -> None:
    card = read_card(bundle / "model.json")
    half = {"sensitivity_v_per_g": 0.8}
    for base, said in ((None, "sensor: base is no table"), (half, "sensor: base: zero_g_v")):
        with pytest.raises(ValueError, match=said):
            replace(card, sensor={**card.sensor, "base": base})
    with pytest.raises(ValueError, match="6 rows of gains for 3 channels"):
        replace(card, base=exact_motion(a_sensor(2)))


GAINS = ({"gains": EXACT.gains[:2]}, {"gains": ((1.0, 2.0),) * 3}, {"base_v": (0.0, 0.0)})
OUTPUTS = ({"static_v": EXACT.static_v[:2]}, {"gravity_v": (0.0, 0.8)}, {"gravity_v": ()})


@pytest.mark.parametrize("wrong", [*GAINS, *OUTPUTS])
def test_sizes_that_do_not_belong_together_are_refused(bundle: Path, wrong: dict) -> None:
    with pytest.raises(ValueError, match="base: "):
        replace(read_card(bundle / "model.json"), base=replace(EXACT, **wrong))

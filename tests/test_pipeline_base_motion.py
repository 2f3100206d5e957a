"""How the skin follows its base, fitted to recordings of a robot that moves: recovered, or refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from moving_robot import BASE, exact_motion, on_a_robot, wandering
from streams import RATE_HZ, a_sensor, still, stream

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.recordings.base_motion import moved_and_left, without_base_motion
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Sensor, read_sensor, write_sensor
from softslide.pipeline.synthesis.synthesize import synthesize

SENSOR = replace(a_sensor(2), base=BASE)
EXACT = exact_motion(SENSOR)


def recorded(root: Path, moves: dict[str, float], sensor: Sensor = SENSOR, split: str = "base") -> Folder:
    """Recordings of 15 s by name, untouched on a robot that leans over by so many degrees at most."""
    manifest = pd.DataFrame({"recording": list(moves), "split": split})

    def one(name: str, tilt_deg: float, seed: int) -> Recording:
        quiet = stream(still(15.0), accelerometers=2, seed=seed)
        felt = wandering(len(quiet), RATE_HZ, tilt_deg, shake_g=0.002 * tilt_deg, seed=seed)
        samples = on_a_robot(quiet, sensor, felt, seed)
        base_v = None if sensor.base is None else samples[:, 6:]
        return Recording(name, np.arange(len(quiet)) / RATE_HZ, samples[:, :6], base_v=base_v)

    recordings = (one(name, tilt_deg, n) for n, (name, tilt_deg) in enumerate(moves.items()))
    return write_folder(root, sensor, manifest, recordings)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """One recording of a robot that leans over, read without the motion."""
    return without_base_motion(recorded(tmp_path_factory.mktemp("robot") / "lab", {"one": 20.0}))


def test_how_the_skin_follows_the_base_is_recovered(tmp_path: Path) -> None:
    folder = without_base_motion(recorded(tmp_path / "lab", {"one": 20.0, "two": 20.0}))
    found = folder.base_motion
    assert found is not None
    assert np.array(found.gains) == pytest.approx(np.array(EXACT.gains), abs=0.03)
    # What it reads in the attitude in which the robot began.
    assert np.array(found.static_v) == pytest.approx(np.array(EXACT.static_v), abs=0.03)
    moved_g, before_v, left_v = moved_and_left(folder)
    assert (np.diff(moved_g) >= 0).all()
    assert before_v > 0.05
    assert left_v < 3e-3  # the noise of a block is 1.1 mV in the skin and 1.8 from the base


def test_recordings_are_loaded_without_the_motion(robot: Folder) -> None:
    moving, level = robot.read("one"), robot.load("one")
    assert moving.volts[:, 0].std() > 0.05
    assert level.volts[:, 0].std() < 0.015
    assert moving.base_v is not None
    assert moving.samples.shape == (15_000, 9)
    # Used already: nothing can take it out twice.
    assert level.base_v is None


def test_without_a_base_a_folder_stays_as_it_is(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "lab", {"one": 0.0}, replace(SENSOR, base=None), "base")
    assert without_base_motion(folder) is folder
    assert folder.load("one").base_v is None
    with pytest.raises(InputError, match="column 'base_vx' is missing"):
        without_base_motion(replace(folder, sensor=SENSOR))


@pytest.mark.parametrize(
    ("tilt_deg", "split", "says"),
    [
        (20.0, "calibration", r"no recording is of the split 'base'.*record a minute"),
        (0.5, "base", "the base hardly moves"),
    ],
)
def test_a_base_needs_recordings_of_its_motion(tmp_path: Path, tilt_deg, split, says) -> None:
    with pytest.raises(InputError, match=says):
        without_base_motion(recorded(tmp_path / "lab", {"one": tilt_deg}, split=split))


def test_a_recording_in_which_the_robot_lies_on_its_side_is_refused(robot: Folder) -> None:
    turned = replace(robot, base_motion=replace(robot.base_motion, base_v=(1.5, 1.5, 2.6)))
    with pytest.raises(InputError, match=r"one\.parquet: from 0 s on the base leans over further"):
        turned.load("one")


def test_an_accelerometer_of_the_skin_is_not_named_as_the_base() -> None:
    named = replace(SENSOR.accelerometers[0], name="base")
    with pytest.raises(ValueError, match=r"as the robot's under \[base\]"):
        replace(SENSOR, accelerometers=(named,))


def test_recordings_without_the_motion_are_not_written_as_with_it(robot: Folder, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="do not both have a base"):
        write_folder(tmp_path / "out", robot.sensor, robot.manifest, [robot.load("one")])
    assert not (tmp_path / "out").exists()


def test_nothing_is_synthesized_of_a_robot(tmp_path: Path) -> None:
    write_sensor(tmp_path / "sensor.toml", replace(read_sensor(DEFAULT_SENSOR), base=BASE))
    with pytest.raises(InputError, match=r"sensor\.toml: has a \[base\], and synthetic slides none"):
        synthesize(tmp_path / "out", slides=1, sensor=tmp_path / "sensor.toml")

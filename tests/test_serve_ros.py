"""ROS 2's messages, as they travel: accelerations become volts, an estimate a velocity with its covariance."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from lab_files import IMU, _vectors
from rosbags.typesys import Stores, get_typestore
from streams import pass_over, pushed, still, stream

from softslide.command_line import parser
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.features.stream.tracker import SlideState
from softslide.features.units import STANDARD_GRAVITY
from softslide.serve.localizer import Localizer
from softslide.serve.stream.ros import UNKNOWN, imu_reader, with_velocity

STORE = get_typestore(Stores.ROS2_HUMBLE)
TWIST = "geometry_msgs/msg/TwistWithCovarianceStamped"
ROS_PACKAGE = Path(__file__).parents[1] / "docs" / "ros2" / "softslide_ros"
VOLTS = stream(still(0.6), pass_over(1.0), still(0.4))


def travelled(message: Any, kind: str) -> Any:
    """The message as it arrives."""
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, kind), kind)


def test_accelerations_give_the_estimates_of_their_volts(localizer: Localizer) -> None:
    element = localizer.card.sensor["accelerometers"][0]
    acceleration = (VOLTS - element["zero_g_v"]) / element["sensitivity_v_per_g"] * STANDARD_GRAVITY
    time_s = np.arange(len(VOLTS)) / localizer.card.sample_rate_hz
    read = imu_reader("imu", localizer.card)
    chunks = [read(travelled(m, IMU)) for _, m in _vectors(STORE, acceleration, time_s, IMU, ros1=False)]
    np.testing.assert_allclose(np.concatenate([volts for volts, _ in chunks]), VOLTS, atol=1e-9)
    plain = pushed(localizer, VOLTS)
    localizer.reset()
    found = [estimate for chunk in chunks for estimate in localizer.push(*chunk)]
    assert len(found) == len(plain)
    assert sum(estimate.valid for estimate in found) > 10
    for a, b in zip(found, plain, strict=True):
        assert (a.valid, a.state, a.contact) == (b.valid, b.state, b.contact)
        assert a.direction_deg == pytest.approx(b.direction_deg, abs=1e-3, nan_ok=True)
        assert a.offset_mm == pytest.approx(b.offset_mm, abs=1e-3, nan_ok=True)


def test_several_accelerometers_or_an_imu_without_acceleration_are_refused(
    localizer: Localizer, two_boards: Path
) -> None:
    with pytest.raises(InputError, match="an Imu is one accelerometer"):
        imu_reader("imu", Localizer.load(two_boards).card)
    (_, message), *_ = _vectors(STORE, np.zeros((1, 3)), np.zeros(1), IMU, ros1=False)
    message.linear_acceleration_covariance[0] = -1.0
    with pytest.raises(InputError, match="no acceleration"):
        imu_reader("imu", localizer.card)(travelled(message, IMU))


def empty_twist() -> Any:
    types = STORE.types
    linear, angular = (types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0) for _ in range(2))
    twist = types["geometry_msgs/msg/Twist"](linear=linear, angular=angular)
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="skin")
    inner = types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=np.zeros(36))
    return types[TWIST](header=header, twist=inner)


def along_y(**more: float) -> Estimate:
    """4 mm/s along y: speed within 0.4 mm/s, direction within 2 degrees."""
    bounds = {"direction_lo_deg": 88.0, "direction_hi_deg": 92.0, "speed_lo_mm_s": 3.6, "speed_hi_mm_s": 4.4}
    values = {"direction_deg": 90.0, "speed_mm_s": 4.0, "vx_mm_s": 0.0, "vy_mm_s": 4.0, **bounds, **more}
    return Estimate(0.0, SlideState.SLIDE, valid=True, **values)


@pytest.mark.parametrize("own", [False, True])
def test_a_velocity_has_the_covariance_of_its_intervals(own: bool) -> None:
    """Intervals are 90 %: 1.645 standard deviations to either side. Of its own, where it has some."""
    bounds = {"vx_lo_mm_s": -0.2, "vx_hi_mm_s": 0.2, "vy_lo_mm_s": 3.0, "vy_hi_mm_s": 5.0}
    message = travelled(with_velocity(empty_twist(), along_y(**(bounds if own else {}))), TWIST)
    assert (message.twist.twist.linear.x, message.twist.twist.linear.y) == (0.0, 0.004)
    covariance = message.twist.covariance.reshape(6, 6)
    np.testing.assert_array_equal(covariance, covariance.T)
    halves = (2e-4, 1e-3) if own else (0.004 * np.radians(2.0), 4e-4)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)[:2]), np.array(halves) / 1.645)
    assert abs(covariance[0, 1]) < 1e-15
    assert (np.diag(covariance)[2:] == UNKNOWN).all()


def test_a_velocity_without_intervals_is_hardly_known() -> None:
    velocity = along_y(speed_lo_mm_s=np.nan, direction_lo_deg=np.nan)
    covariance = travelled(with_velocity(empty_twist(), velocity), TWIST).twist.covariance.reshape(6, 6)
    np.testing.assert_array_equal(covariance, UNKNOWN * np.eye(6))


def test_the_launch_file_starts_a_command_that_there_is() -> None:
    launch = ElementTree.parse(ROS_PACKAGE / "launch" / "serve.launch.xml").getroot()
    values = {"bundle": "m"} | {arg.attrib["name"]: arg.get("default", "m") for arg in launch.iter("arg")}
    (executable,) = launch.iter("executable")
    command = re.sub(r"\$\(var (\w+)\)", lambda found: values[found[1]], executable.attrib["cmd"]).split()
    options = parser().parse_args(command[1:])
    assert command[0] == "softslide"
    assert (str(options.model), options.source, options.sink) == ("m", "ros2:///skin/volts", ["ros2:///skin"])


@pytest.mark.long
def test_colcon_finds_the_package(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True, timeout=300)
    tools = tmp_path / "env" / "bin"
    subprocess.run(
        [tools / "pip", "install", "-q", "colcon-ros==0.5.0", "colcon-package-information==0.4.0"],
        check=True,
        timeout=600,
    )
    listing = [tools / "colcon", "--log-base", tmp_path / "log", "list", "--base-paths", ROS_PACKAGE]
    done = subprocess.run(listing, check=True, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["softslide_ros", str(ROS_PACKAGE), "(ros.ament_cmake)"]

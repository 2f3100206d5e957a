"""ROS 2, where rclpy is present: volts or accelerations in from a topic; positions, velocities and estimates out."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from softslide.features.card import HALF_WIDTH_SD, Card
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate
from softslide.features.stream.drift import measures_gravity
from softslide.features.units import STANDARD_GRAVITY
from softslide.serve.records import as_json
from softslide.serve.stream.framing import Chunk
from softslide.serve.stream.sources import WAIT_S

# Variance of what no estimate has: the velocity across the skin, and any turning.
UNKNOWN = 1e6

Read = Callable[[Any], Chunk]


def samples(topic: str, channels: int) -> Iterator[Chunk | tuple[()]]:
    """Chunks from a topic of std_msgs/Float64MultiArray, whose data are rows of the channels' volts.

    Raises:
        InputError: rclpy is not installed, or a message is not a whole number of rows.
    """

    def read(message: Any) -> Chunk:
        volts = np.asarray(message.data, float)
        if len(volts) % channels:
            raise InputError(f"topic {topic}: {len(volts)} numbers; send rows of {channels} volts")
        return volts.reshape(-1, channels), None

    rclpy, node = _node("softslide_source", "source", f"ros2://{topic}")
    from std_msgs.msg import Float64MultiArray

    return _spun(rclpy, node, Float64MultiArray, topic, read)


def accelerations(topic: str, card: Card) -> Iterator[Chunk | tuple[()]]:
    """Chunks from a topic of sensor_msgs/Imu, a sample a message, with its header's stamp.

    Raises:
        InputError: rclpy is not installed, or the card's sensor is more than one accelerometer or another element.
    """
    read = imu_reader(topic, card)
    rclpy, node = _node("softslide_source", "source", f"ros2+imu://{topic}")
    from sensor_msgs.msg import Imu

    return _spun(rclpy, node, Imu, topic, read)


def imu_reader(topic: str, card: Card) -> Read:
    """What turns an Imu's linear acceleration (m/s2) into the volts (1, 3) that the card's accelerometer gives.

    Raises:
        InputError: the card's sensor is more than one accelerometer, or another sensing element.
    """
    element, *others = card.sensor["accelerometers"]
    if others or card.base is not None or not measures_gravity(element):
        raise InputError(
            f"ros2+imu://{topic}: an Imu is one accelerometer, {card.sensor['name']} is not; send rows of outputs to "
            "ros2://TOPIC",
            "source",
        )
    zero_v, v_per_g = float(element["zero_g_v"]), float(element["sensitivity_v_per_g"])

    def read(message: Any) -> Chunk:
        # How an Imu says that it measures none (sensor_msgs/Imu).
        if message.linear_acceleration_covariance[0] == -1.0:
            raise InputError(
                f"topic {topic}: its messages hold no acceleration; name another topic", "source"
            )
        a, stamp = message.linear_acceleration, message.header.stamp
        volts = zero_v + v_per_g / STANDARD_GRAVITY * np.array([[a.x, a.y, a.z]])
        return volts, np.array([stamp.sec + 1e-9 * stamp.nanosec])

    return read


def _spun(rclpy: Any, node: Any, kind: Any, topic: str, read: Read) -> Iterator[Chunk | tuple[()]]:
    waiting: deque[Any] = deque()
    node.create_subscription(kind, topic, waiting.append, 100)
    try:
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=WAIT_S)
            if not waiting:
                yield ()
            while waiting:
                yield read(waiting.popleft())
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


class RosSink:
    """Valid estimates as geometry_msgs/PointStamped in m on TOPIC/position and as TwistWithCovarianceStamped in m/s on
    TOPIC/velocity, all as JSON lines on TOPIC/estimate.

    A PointStamped has no field for a covariance; the intervals are in the JSON.
    """

    def __init__(self, topic: str) -> None:
        _, self._node = _node("softslide_sink", "sink", f"ros2://{topic}")
        from geometry_msgs.msg import PointStamped, TwistWithCovarianceStamped
        from std_msgs.msg import String

        self._point, self._twist, self._string = PointStamped, TwistWithCovarianceStamped, String
        self._velocity = self._node.create_publisher(TwistWithCovarianceStamped, f"{topic}/velocity", 10)
        self._position = self._node.create_publisher(PointStamped, f"{topic}/position", 10)
        self._estimate = self._node.create_publisher(String, f"{topic}/estimate", 10)

    def write(self, estimate: Estimate) -> None:
        """Publishes one estimate."""
        self._estimate.publish(self._string(data=as_json(estimate)))
        if not estimate.valid:
            return
        if math.isfinite(estimate.x_mm):
            message = self._stamped(self._point())
            message.point.x, message.point.y = estimate.x_mm / 1000.0, estimate.y_mm / 1000.0
            self._position.publish(message)
        if math.isfinite(estimate.vx_mm_s):
            self._velocity.publish(with_velocity(self._stamped(self._twist()), estimate))

    def _stamped(self, message: Any) -> Any:
        message.header.frame_id = "skin"
        message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def close(self) -> None:
        """Destroys the node."""
        self._node.destroy_node()


def with_velocity(message: Any, estimate: Estimate) -> Any:
    """The TwistWithCovarianceStamped, with the estimate's velocity along x and y in m/s and its covariance."""
    linear = message.twist.twist.linear
    linear.x, linear.y = estimate.vx_mm_s / 1000.0, estimate.vy_mm_s / 1000.0
    covariance = np.diag(np.full(6, UNKNOWN))
    covariance[:2, :2] = 1e-6 * _velocity_covariance(estimate)
    message.twist.covariance = covariance.ravel()
    return message


def _velocity_covariance(estimate: Estimate) -> np.ndarray:
    """(2, 2) (mm/s)^2, from the 90 % intervals: of the velocity, or where it has none of speed and direction."""
    if math.isfinite(estimate.vx_lo_mm_s + estimate.vy_lo_mm_s):
        halves = estimate.vx_hi_mm_s - estimate.vx_lo_mm_s, estimate.vy_hi_mm_s - estimate.vy_lo_mm_s
        return np.diag(np.square(np.array(halves) / 2.0 / HALF_WIDTH_SD))
    a = math.radians(estimate.direction_deg)
    speed_sd = (estimate.speed_hi_mm_s - estimate.speed_lo_mm_s) / 2.0 / HALF_WIDTH_SD
    turn_sd = math.radians(estimate.direction_hi_deg - estimate.direction_lo_deg) / 2.0 / HALF_WIDTH_SD
    if not math.isfinite(speed_sd + turn_sd):
        return np.diag([UNKNOWN * 1e6] * 2)
    along, across = np.array([math.cos(a), math.sin(a)]), np.array([-math.sin(a), math.cos(a)])
    aside = estimate.speed_mm_s * turn_sd
    return speed_sd**2 * np.outer(along, along) + aside**2 * np.outer(across, across)


def _node(name: str, parameter: str, topic: str) -> tuple[Any, Any]:
    try:
        import rclpy
    except ImportError:
        raise InputError(
            f"{topic}: rclpy is not here; source a ROS 2 installation first", parameter
        ) from None
    if not rclpy.ok():
        rclpy.init()
    return rclpy, rclpy.create_node(name)

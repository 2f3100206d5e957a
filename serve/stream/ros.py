"""ROS 2, where rclpy is present: volts in from a topic, positions and estimates out."""

import json
import math
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np

from features.errors import InputError
from features.estimate import Estimate
from serve.records import record
from serve.stream.framing import Chunk

_WAIT_S = 0.2


def samples(topic: str, channels: int) -> Iterator[Chunk | tuple[()]]:
    """Chunks from a topic of std_msgs/Float64MultiArray, whose data are rows of the channels' volts.

    Raises:
        InputError: rclpy is not installed, or a message is no whole number of rows.
    """
    rclpy, node = _node("softslide_source", "source", f"ros2://{topic}")
    from std_msgs.msg import Float64MultiArray

    waiting: deque[Any] = deque()
    node.create_subscription(Float64MultiArray, topic, waiting.append, 100)
    return _spun(rclpy, node, waiting, topic, channels)


def _spun(
    rclpy: Any, node: Any, waiting: deque[Any], topic: str, channels: int
) -> Iterator[Chunk | tuple[()]]:
    try:
        while rclpy.ok():
            rclpy.spin_once(node, timeout_sec=_WAIT_S)
            if not waiting:
                yield ()
            while waiting:
                volts = np.asarray(waiting.popleft().data, float)
                if len(volts) % channels:
                    raise InputError(f"topic {topic}: {len(volts)} numbers; send rows of {channels} volts")
                yield volts.reshape(-1, channels), None
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


class RosSink:
    """Valid estimates as geometry_msgs/PointStamped in m on TOPIC/position, all as JSON lines on TOPIC/estimate.

    A PointStamped has no field for a covariance; the intervals are in the JSON.
    """

    def __init__(self, topic: str) -> None:
        _, self._node = _node("softslide_sink", "sink", f"ros2://{topic}")
        from geometry_msgs.msg import PointStamped
        from std_msgs.msg import String

        self._point, self._string = PointStamped, String
        self._position = self._node.create_publisher(PointStamped, f"{topic}/position", 10)
        self._estimate = self._node.create_publisher(String, f"{topic}/estimate", 10)

    def write(self, estimate: Estimate) -> None:
        """Publishes one estimate."""
        self._estimate.publish(self._string(data=json.dumps(record(estimate), allow_nan=False)))
        if not (estimate.valid and math.isfinite(estimate.x_mm)):
            return
        message = self._point()
        message.header.frame_id = "skin"
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.point.x, message.point.y = estimate.x_mm / 1000.0, estimate.y_mm / 1000.0
        self._position.publish(message)

    def close(self) -> None:
        """Destroys the node."""
        self._node.destroy_node()


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

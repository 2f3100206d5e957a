"""A sensor on a robot that moves: what its accelerometers and the base's give, from what they give on a table.

Each output on the table is the direction in which an accelerometer feels gravity. On the robot it is turned by the same
rotation, the shortest one from the z axis, from where gravity and the robot's acceleration then are.
"""

import numpy as np

from softslide.features.base_motion import BaseMotion
from softslide.pipeline.sensor import Base, Sensor

BASE = Base(sensitivity_v_per_g=0.5, zero_g_v=1.5)
_SIN, _COS = np.sin(np.deg2rad([25.0, 8.0])), np.cos(np.deg2rad([25.0, 8.0]))
# The base's accelerometer is turned about z, and tilted.
_TURNED = np.array([[_COS[0], -_SIN[0], 0.0], [_SIN[0], _COS[0], 0.0], [0.0, 0.0, 1.0]])
MOUNTED = _TURNED @ np.array([[_COS[1], 0.0, _SIN[1]], [0.0, 1.0, 0.0], [-_SIN[1], 0.0, _COS[1]]])


def felt_g(roll_deg: np.ndarray, pitch_deg: np.ndarray) -> np.ndarray:
    """(n, 3) g: gravity in the axes of a robot that rolls and pitches (n,)."""
    roll, pitch = np.deg2rad(roll_deg), np.deg2rad(pitch_deg)
    return np.stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)], axis=-1)


def on_a_robot(volts: np.ndarray, sensor: Sensor, felt: np.ndarray, seed: int | None = 0) -> np.ndarray:
    """Outputs on a table (n, 3 A) V and what a robot feels (n, 3) g -> samples (n, 3 A + 3) V. seed: None, no noise."""
    parts = []
    for n, a in enumerate(sensor.accelerometers):
        table = (volts[:, 3 * n : 3 * n + 3] - a.zero_g_v) / a.sensitivity_v_per_g
        size = np.linalg.norm(table, axis=1, keepdims=True)
        axis = np.cross([0.0, 0.0, 1.0], table / size)
        cosine = table[:, 2:] / size
        along = axis * np.sum(axis * felt, axis=1, keepdims=True) / (1.0 + cosine)
        turned = felt * cosine + np.cross(axis, felt) + along
        parts.append(a.zero_g_v + a.sensitivity_v_per_g * size * turned)
    noise = 0.0 if seed is None else np.random.default_rng(seed).normal(0.0, 0.005, felt.shape)
    return np.hstack([*parts, BASE.zero_g_v + BASE.sensitivity_v_per_g * felt @ MOUNTED.T + noise])


def exact_motion(sensor: Sensor) -> BaseMotion:
    """How the outputs of a sensor without static tilt follow the base's."""
    parts = sensor.accelerometers
    gains = np.vstack([a.sensitivity_v_per_g / BASE.sensitivity_v_per_g * MOUNTED.T for a in parts])
    base_v = BASE.zero_g_v + BASE.sensitivity_v_per_g * MOUNTED[:, 2]
    gravity_v = tuple(v for a in parts for v in (0.0, 0.0, a.sensitivity_v_per_g))
    static_v = tuple(a.zero_g_v + v for a in parts for v in (0.0, 0.0, a.sensitivity_v_per_g))
    return BaseMotion(tuple(map(tuple, gains.tolist())), tuple(base_v.tolist()), static_v, gravity_v)


def wandering(
    samples: int, rate_hz: float, tilt_deg: float, shake_g: float = 0.03, seed: int = 0
) -> np.ndarray:
    """(n, 3) g of a robot that leans over by up to `tilt_deg` about both axes within seconds, and shakes.

    It is level, and at rest, for the first half second.
    """
    generator, t = np.random.default_rng(seed), np.arange(samples) / rate_hz

    def smooth(shortest_s: float, longest_s: float) -> np.ndarray:
        periods, phases = generator.uniform(shortest_s, longest_s, 4), generator.uniform(0.0, 2 * np.pi, 4)
        begun = np.clip(t - 0.5, 0.0, 1.0)
        return begun * np.sin(2 * np.pi * t / periods[:, None] + phases[:, None]).sum(axis=0) / 4

    felt = felt_g(tilt_deg * smooth(3.0, 30.0), tilt_deg * smooth(3.0, 30.0))
    return felt + shake_g * np.stack([smooth(0.3, 3.0) for _ in range(3)], axis=1)

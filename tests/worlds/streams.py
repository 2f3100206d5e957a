"""Generated streams of one or several accelerometers: rest with noise, slides, touches. Seeded."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from softslide.features.estimate import Estimate
from softslide.pipeline.sensor import Accelerometer, Sensor
from softslide.serve.localizer import Localizer

RATE_HZ = 1000.0
ZERO_V = 1.65
GRAVITY_V = 0.8


def a_sensor(accelerometers: int = 1) -> Sensor:
    boards = tuple(Accelerometer(f"a{n}", 5.0 * n, 0.0) for n in range(accelerometers))
    return Sensor("trial", RATE_HZ, (50.0, 50.0), 4.0, 6.0, 0.035, (0.0, 0.0), 5e-4, boards)


def pass_over(seconds: float, amplitude_v: float = 0.15) -> np.ndarray:
    """(n, 3) V: what one slide adds to the static output; V_x swings both ways, V_y one way."""
    s = np.arange(round(seconds * RATE_HZ)) / (seconds * RATE_HZ)
    pulse = np.sin(np.pi * s) ** 2
    return amplitude_v * np.column_stack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])


def still(seconds: float, level_v: np.ndarray | float = 0.0) -> np.ndarray:
    """(n, 3) V: nothing changes."""
    return np.zeros((round(seconds * RATE_HZ), 3)) + level_v


def stream(*parts: np.ndarray, accelerometers: int = 1, seed: int = 0) -> np.ndarray:
    """The parts one after the other as volts (n, 3 A): gravity, noise and the converter's steps on top."""
    signal = np.tile(np.concatenate(parts), (1, accelerometers))
    noise = np.random.default_rng(seed).normal(0.0, 0.005, signal.shape)
    gravity = np.tile([0.0, 0.0, GRAVITY_V], accelerometers)
    return np.round((ZERO_V + gravity + signal + noise) / 5e-4) * 5e-4


CHANNELS = ("a0_vx", "a0_vy", "a0_vz")


def write_csv(
    path: Path, volts: np.ndarray, channels: Sequence[str] = CHANNELS, rate_hz: float = RATE_HZ
) -> Path:
    """Samples (n, C) as a recording, to the last bit."""
    table, header = np.column_stack([np.arange(len(volts)) / rate_hz, volts]), ",".join(["time_s", *channels])
    np.savetxt(path, table, "%.17g", ",", header=header, comments="")
    return path


def pushed(localizer: Localizer, volts: np.ndarray, time_s: np.ndarray | None = None) -> list[Estimate]:
    """The estimates of a fresh stream."""
    localizer.reset()
    return localizer.push(volts, time_s)

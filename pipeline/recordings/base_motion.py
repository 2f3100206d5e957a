"""How a skin's outputs follow those of its base, from recordings in which nothing touches while the robot moves."""

from dataclasses import replace

import numpy as np

from softslide.features.base_motion import BaseMotion
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor

BASE_SPLIT = "base"  # of these recordings
# rms, g: a tilt of a degree. With noise of 0.6 mg a block, a gain is known to 0.1 % after a minute.
LEAST_MOTION_G = 0.02
# rms, in standard deviations of a block's noise, of a magnetometer: its gains are then known to 1 % after a minute.
LEAST_CHANGE_SD = 4.0
# Shorter blocks lower the gains by the base's noise, 2.6 % where it moves by 15 mV rms and blocks of 20 ms have 1.1 mV;
# longer ones average its motion away.
BLOCKS = Conditioning(block_s=0.1)
# So many recordings show the attitude of the calibration.
MOST_RECORDINGS = 24


def without_base_motion(folder: Folder) -> Folder:
    """The folder whose `load` takes out the base's motion; itself where there is no base.

    Raises:
        InputError: as `base_motion_of`.
    """
    motion = base_motion_of(folder)
    return folder if motion is None else replace(folder, base_motion=motion)


def base_motion_of(folder: Folder) -> BaseMotion | None:
    """How the skin follows its base in the recordings of the split `base`; None: the sensor has no base.

    Raises:
        InputError: the sensor has a base and no recording of the split `base`, or the base hardly moves in them.
    """
    sensor = folder.sensor
    if sensor.base is None:
        return None
    moving = _moving(folder)
    if not moving:
        raise InputError(
            f"{folder.root / 'manifest.csv'}: sensor.toml has a [base], and no recording is of the split "
            f"'{BASE_SPLIT}'; record a minute in which the robot moves and nothing touches the skin, or take [base] out"
        )
    blocks = [_blocks(folder, name) for name in moving]
    volts, base = _about_their_means(blocks)
    least = LEAST_MOTION_G * sensor.base.sensitivity_v_per_g
    if not sensor.base.measures_gravity:
        least = LEAST_CHANGE_SD * max(_noise(each[:, -3:]) for each in blocks)
    if _principal_rms(base)[-1] < least:
        raise InputError(
            f"{folder.root}: in the recordings of the split '{BASE_SPLIT}' the base hardly moves; tilt it by 10 "
            "degrees and more, about two axes"
        )
    gains = np.linalg.lstsq(base, volts, rcond=None)[0].T
    skin_v, moved_v = np.split(
        np.mean([each.mean(axis=0) for each in blocks], axis=0), [len(sensor.channels)]
    )
    base_v = _attitude_v(folder, moving)
    static_v = skin_v - gains @ (moved_v - base_v)
    return BaseMotion(
        gains=tuple((float(x), float(y), float(z)) for x, y, z in gains),
        base_v=(float(base_v[0]), float(base_v[1]), float(base_v[2])),
        static_v=tuple(static_v.tolist()),
        gravity_v=_gravity_v(sensor, static_v),
    )


def moved_and_left(folder: Folder) -> tuple[np.ndarray, float, float]:
    """Of the split `base`: rms of the base's motion along its principal axes (3,) g, rising, of a magnetometer in the
    unit of its outputs; and the largest rms of an output (V) before the motion is taken out, and after.
    """
    motion, sensor = folder.base_motion, folder.sensor
    assert motion is not None
    assert sensor.base is not None
    volts, base = _about_their_means([_blocks(folder, name) for name in _moving(folder)])
    left, _ = motion.without(volts + motion.static_v, base + motion.base_v)
    before_v, after_v = (float(np.sqrt(np.mean(v**2, axis=0)).max()) for v in (volts, left - motion.static_v))
    scale = sensor.base.sensitivity_v_per_g if sensor.base.measures_gravity else 1.0
    return _principal_rms(base) / scale, before_v, after_v


def _moving(folder: Folder) -> list[str]:
    return [str(name) for name in folder.manifest.index[folder.manifest["split"] == BASE_SPLIT]]


def _gravity_v(sensor: Sensor, static_v: np.ndarray) -> tuple[float, ...]:
    """(C,): what gravity makes of the outputs at rest, 0 of other sensing elements'."""
    pairs = zip(sensor.accelerometers, static_v.reshape(-1, 3).tolist(), strict=True)
    return tuple(v - a.zero_g_v if a.measures_gravity else 0.0 for a, outputs in pairs for v in outputs)


def _attitude_v(folder: Folder, moving: list[str]) -> np.ndarray:
    """(3,) V: what the base reads in the recordings to calibrate with, or without any as it begins to move."""
    learned = folder.select(*CALIBRATION).manifest.index
    names = [str(name) for name in learned[:: max(1, len(learned) // MOST_RECORDINGS)]] or moving
    return np.median([_blocks(folder, name)[0, -3:] for name in names], axis=0)


def _about_their_means(blocks: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """All recordings' blocks (m, C + 3) V, each about its recording's mean: skin (m, C) V and base (m, 3) V."""
    together = np.concatenate([each - each.mean(axis=0) for each in blocks])
    return together[:, :-3], together[:, -3:]


def _blocks(folder: Folder, name: str) -> np.ndarray:
    """A recording's block means (m, C + 3) V."""
    blocks = block_means(folder.read(name).samples, BLOCKS, folder.sensor.sample_rate_hz)
    if not len(blocks):
        raise InputError(f"{folder.root}: {name} is shorter than a block of {BLOCKS.block_s:g} s")
    return blocks


def _noise(base: np.ndarray) -> float:
    """The largest standard deviation of a block's noise in the base's outputs (m, 3), in their unit."""
    # Second differences of what changes evenly are noise alone.
    return float(np.sqrt(np.mean(np.diff(base, 2, axis=0) ** 2, axis=0) / 6.0).max(initial=0.0))


def _principal_rms(base: np.ndarray) -> np.ndarray:
    """(3,) V, rising: rms of (m, 3) V along its principal axes."""
    return np.sqrt(np.linalg.eigvalsh(base.T @ base / len(base)).clip(min=0.0))

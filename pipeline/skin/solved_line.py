"""The solution of one line of an atlas, and what the boards read of it."""

import math
from functools import lru_cache

import numpy as np

from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.lines import PER_BOARD, Line
from softslide.pipeline.skin.mesh import skin_mesh
from softslide.pipeline.skin.solver import Skin, Statistics
from softslide.pipeline.skin.system import Material, State


@lru_cache(maxsize=1)
def skin_of(sensor: Sensor) -> Skin:
    """The skin of a design; a process keeps the last one, with its sparse pattern analysed."""
    return Skin(skin_mesh(sensor), material_of(sensor))


def material_of(sensor: Sensor) -> Material:
    """What a design's skin is made of and what touches it."""
    return Material(
        sensor.skin.shear_modulus_mpa,
        sensor.skin.bulk_modulus_mpa,
        sensor.skin.friction,
        sensor.indenter_diameter_mm / 2,
        sensor.indenter_edge_mm,
    )


def gravity(rotations: np.ndarray) -> np.ndarray:
    """Gravity (boards, 3) g that accelerometers at these board rotations (boards, 3, 3) read.

    The accelerometer's x and y point against the board's, so that pressing at x < x_ref, which lowers the
    board's left side, lowers vx as in the article; z points out of the skin.
    """
    return rotations[:, 2, :] * np.array([-1.0, -1.0, 1.0])


def solve_line(
    sensor: Sensor, line: Line, along_mm: np.ndarray, depth_mm: float, pressure_mpa: float, inflated: State
) -> tuple[np.ndarray, Statistics]:
    """Slides the indenter once, `depth_mm` below the flat skin's upper face, over `along_mm` (n,) ascending.

    Returns:
        (n, channels) as `PER_BOARD` says, nan where no equilibrium was found; what it cost.
    """
    skin = skin_of(sensor)
    skin.statistics = Statistics()
    centres = line.centres(along_mm[:: line.sense], depth_mm, sensor)
    postures, forces = skin.slide(inflated, pressure_mpa, centres)
    boards = len(sensor.accelerometers)
    values = np.full((len(centres), PER_BOARD * boards + 3), np.nan)
    for n, posture in enumerate(postures):
        if posture is not None:
            values[n] = np.concatenate([channels(skin, posture, inflated), forces[n]])
    return values[:: line.sense], skin.statistics


def channels(skin: Skin, posture: State, inflated: State) -> np.ndarray:
    """One posture against the inflated skin's, (boards * PER_BOARD,)."""
    tilt = gravity(posture.rotations) - gravity(inflated.rotations)
    moved = skin.system.boards(posture.unknowns - inflated.unknowns)[:, 0]
    yaw, rest = ([math.atan2(r[1, 0], r[0, 0]) for r in state.rotations] for state in (posture, inflated))
    return np.column_stack([tilt, moved, np.subtract(yaw, rest)]).ravel()

"""File units to volts: units, calibration, the board's rotation and signs.

An accelerometer that is calibrated, turned or flipped goes through g: with readings u in volts, offsets b and
gains M (V/g) of its calibration, its board's signs S and rotation R about z,

    a = R S M^-1 (u - b),    v = zero_g + sensitivity a,

so that every board comes out in the axes and with the nominal figures of `sensor.toml`. The volts of
all others are kept to the last bit.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from softslide.features.errors import InputError
from softslide.features.units import STANDARD_GRAVITY
from softslide.pipeline.importers.import_map import Board, Map, Signal
from softslide.pipeline.recordings.text_table import numbers, read_text_table
from softslide.pipeline.sensor import Accelerometer, Base

POSITIONS = {
    "+x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "+y": (0, 1, 0),
    "-y": (0, -1, 0),
    "+z": (0, 0, 1),
    "-z": (0, 0, -1),
}


# From (n, outputs) in the map's units to (n, outputs) V.
Converter = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Calibration:
    """Offsets (3,) V and gains (3, 3) V/g of one board: u = offset + gain a."""

    offset_v: np.ndarray
    gain_v_per_g: np.ndarray


def converter(mapping: Map) -> Converter:
    """A function from (n, channels) in the map's units to (n, channels) V in `Sensor.columns` order.

    Raises:
        InputError: a calibration file is missing or bad.
    """
    boards = [_board_converter(mapping, part) for part in mapping.sensor.parts]
    return lambda raw: np.hstack([board(raw[:, 3 * k : 3 * k + 3]) for k, board in enumerate(boards)])


def _board_converter(mapping: Map, part: Accelerometer | Base) -> Converter:
    """Of one accelerometer's three outputs."""
    board = mapping.boards.get(part.name, Board())
    signals = [mapping.channels[f"{part.name}_v{axis}"] for axis in "xyz"]
    # The figures of `sensor.toml`, alike on every axis.
    calibration = Calibration(np.full(3, part.zero_g_v), np.eye(3) * part.sensitivity_v_per_g)
    if board.calibration:
        calibration = read_calibration(mapping.path.parent / board.calibration, part.name)

    def to_volts(raw: np.ndarray) -> np.ndarray:
        volts = np.column_stack([_as_volts(raw[:, i], signal, part) for i, signal in enumerate(signals)])
        if not (board.calibration or board.flip or board.turn_deg):
            return volts
        measured = (volts - calibration.offset_v) @ np.linalg.inv(calibration.gain_v_per_g).T
        return part.zero_g_v + part.sensitivity_v_per_g * (measured @ _board_to_skin(board).T)

    return to_volts


def _as_volts(raw: np.ndarray, signal: Signal, part: Accelerometer | Base) -> np.ndarray:
    """One output in V; accelerations as the nominal accelerometer would give them."""
    if signal.unit in ("g", "m/s2"):
        g = raw if signal.unit == "g" else raw / STANDARD_GRAVITY
        return part.zero_g_v + part.sensitivity_v_per_g * g
    if signal.unit == "mV":
        return raw / 1000
    if signal.unit == "counts":
        return (raw - signal.zero_count) * signal.volts_per_count
    return raw


def _board_to_skin(board: Board) -> np.ndarray:
    """(3, 3) R S: the signs first, then the rotation about z."""
    angle = np.deg2rad(board.turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return turn @ np.diag([-1.0 if axis in board.flip else 1.0 for axis in "xyz"])


def read_calibration(path: Path, accelerometer: str) -> Calibration:
    """A six-position file: `accelerometer, position, vx, vy, vz`, mean volts in each position.

    position: the axis that points up (+x) or down (-x). An axis that points up reads +1 g. Twelve unknowns
    from eighteen readings, by least squares.

    Raises:
        InputError: no such table, a position is missing, an axis that hardly responds to gravity.
    """
    table = read_text_table(path, "a calibration is a table of six positions next to the map")
    outputs = ["vx", "vy", "vz"]
    for column in ("accelerometer", "position", *outputs):
        if column not in table:
            raise InputError(f"{path}: column '{column}' is missing; add it")
    rows = table[table["accelerometer"] == accelerometer].set_index("position")
    if sorted(rows.index) != sorted(POSITIONS):
        raise InputError(
            f"{path}: {accelerometer} needs one row for each of {', '.join(POSITIONS)}; add or drop rows"
        )
    volts = rows.loc[list(POSITIONS), outputs].apply(numbers).to_numpy()
    if not np.isfinite(volts).all():
        raise InputError(f"{path}: {accelerometer} has a reading that is not a number; correct it")
    gravity = np.column_stack([np.ones(6), np.array(list(POSITIONS.values()), dtype=float)])
    solution = np.linalg.lstsq(gravity, volts, rcond=None)[0]
    gain = solution[1:].T
    if np.linalg.cond(gain) > 10:
        raise InputError(f"{path}: {accelerometer} hardly responds to gravity on one axis; measure it again")
    return Calibration(solution[0], gain)

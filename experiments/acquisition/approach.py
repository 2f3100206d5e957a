"""The height of the flat skin, by a slow approach with a stage: the ball goes down until the accelerometer shows it."""

import time

import numpy as np

from softslide.experiments.acquisition.capture import POLL_S, Listener
from softslide.experiments.acquisition.stage import Stage
from softslide.features.angles import tilt_channels
from softslide.features.errors import InputError

STEP_MM = 0.05  # the height is known to two of these
SETTLE_S, READ_S = 0.3, 0.2  # after a step, and for a level
MOST_MM = 5.0  # that it is lowered by: a dead accelerometer would let it go on
RESTS = 10  # levels before the first step
SHOWS = 8.0  # times the levels' standard deviation at rest
LEAST_V = 1e-4  # of that deviation: a converter's steps may hide it


def approach(stage: Stage, listener: Listener, most_mm: float) -> float:
    """Lowers the ball over the chamber's middle, by most_mm at most, until the tilt outputs change; by how much, mm.

    The stage counts depths from there then. Its origin is above the skin.

    Raises:
        InputError: nothing changed, or no samples came; also as the methods of `Stage`.
    """
    stage.place((0.0, 0.0), 0.0)
    rests = np.array([_level(listener) for _ in range(RESTS)])
    shows_v = SHOWS * np.maximum(rests.std(axis=0), LEAST_V)
    for step in range(1, round(most_mm / STEP_MM) + 1):
        stage.lower(step * STEP_MM)
        time.sleep(SETTLE_S)
        if (np.abs(_level(listener) - rests.mean(axis=0)) > shows_v).any():
            stage.count_from(step * STEP_MM)
            return step * STEP_MM
    raise InputError(f"{most_mm:g} mm: no output changes; see where the ball is, or begin lower", "approach")


def _level(listener: Listener) -> np.ndarray:
    """Mean tilt outputs (2 A,) V of the next READ_S."""
    listener.take()
    rows = list[np.ndarray]()
    while sum(map(len, rows)) < READ_S * listener.sensor.sample_rate_hz:
        if reason := listener.why_silent():
            raise InputError(reason, "approach")
        time.sleep(POLL_S)
        rows += [volts[:, tilt_channels(volts.shape[1])] for volts, _ in listener.take()]
    return np.concatenate(rows).mean(axis=0)

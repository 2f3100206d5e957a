"""MiniRocket (Dempster, Schmidt, Webb 2021) with ridge regression as a peer, in an environment of its own.

aeon holds numba, numpy and pandas below what this project uses. Nothing of either is mixed: arrays go over in files.
"""

import subprocess
import tempfile
from pathlib import Path

import numpy as np

from experiments.own_environment import AEON, environment, variables
from features.vector.energy import energy_clock, tilt_outputs
from models.classical import regression
from pipeline.recordings.windows import LabelledWindows

# The line and the speed: without the place along it.
OUTPUTS = regression.OUTPUTS[:4]
SCRIPT = Path(__file__).with_name("minirocket_regressor.py")


def fit_and_predict(taught: LabelledWindows, volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fits to the taught windows: rows (m, 4) of `OUTPUTS` for windows volts (m, 3 A, 64) V.

    Also the time (w,) in s that each of the first windows took on its own.

    Raises:
        InputError: the environment cannot be built.
    """
    python = environment("minirocket", AEON)
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "given.npz", Path(folder) / "found.npz"
        waves, scales = shape_and_scale(taught.volts)
        asked_waves, asked_scales = shape_and_scale(volts)
        np.savez(
            given,
            waves=waves,
            scales=scales,
            targets=regression.targets(taught)[:, : len(OUTPUTS)],
            asked_waves=asked_waves,
            asked_scales=asked_scales,
        )
        subprocess.run([python, SCRIPT, given, found], env=variables(), check=True)
        with np.load(found) as file:
            rows, window_s = file["rows"], file["window_s"]
    assert rows.shape == (len(volts), len(OUTPUTS))
    return rows, window_s


def shape_and_scale(volts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V_x and V_y over their peak (n, 2 A, 64) float32; the peak's and the energy width's logarithms (n, 2).

    The width is a share of the window: nothing here has a unit of time, so no speed leaks in.
    """
    tilt = tilt_outputs(volts)
    peak = np.abs(tilt).max(axis=(1, 2)) + 1e-9
    _, width = energy_clock(tilt)
    return (tilt / peak[:, None, None]).astype(np.float32), np.log(np.stack([peak, width], axis=1))

"""Centre and width of a slide's signal energy in time: a time scale without onset, end or direction.

Slides of any speed v along one line give the same outputs as functions of s = v t. So v times any width in time is a
length that depends on the line alone, and log(v sigma_t) is a far easier target than log v.
"""

import numpy as np

from softslide.features.angles import tilt_channels


def energy_clock(tilt: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and width of the energy E_i = |V_i|^2, both (...) as fractions of the window.

    tilt: (..., K, N) V, the V_x and V_y of every accelerometer in N bins with centres u_i:
    centre = sum(E u) / sum(E), width = sqrt(sum(E (u - centre)^2) / sum(E)). The energy of a bin is taken to be
    spread evenly over it (variance 1 / 12 N^2), which keeps the width positive. A window without signal counts as
    even.
    """
    bins = tilt.shape[-1]
    energy = np.square(tilt).sum(axis=-2)
    total = energy.sum(axis=-1, keepdims=True)
    silent = total <= 0
    share = np.where(silent, 1.0 / bins, energy / np.where(silent, 1.0, total))
    moment = (np.arange(bins) + 0.5) / bins
    centre = (share * moment).sum(axis=-1)
    spread = (share * np.square(moment - centre[..., None])).sum(axis=-1)
    return centre, np.sqrt(spread + 1.0 / (12.0 * bins**2))


def energy_width_s(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
    """sigma_t (...) s of windows volts (..., C, N) V, C = 3 an accelerometer, of length elapsed_s (...) s."""
    return energy_clock(tilt_outputs(volts))[1] * elapsed_s


def tilt_outputs(volts: np.ndarray) -> np.ndarray:
    """V_x and V_y of every accelerometer, (..., 2 A, N) float64, of volts (..., 3 A, N).

    V_z is left out: it varies with the cosine of the tilt, so that a contact hardly changes it while pressure does.
    """
    return np.asarray(volts, np.float64)[..., tilt_channels(volts.shape[-2]), :]

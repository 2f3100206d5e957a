"""The skin's lag: a standard linear solid between the equilibrium that the atlas knows and what a board does."""

import numpy as np
from scipy.signal import lfilter


def standard_solid(values: np.ndarray, step_s: float, delayed: float, tau_s: float) -> np.ndarray:
    """Equilibrium values (n, channels) at even steps become lagging ones.

    A spring and a Kelvin-Voigt element in series: of every change the share 1 - `delayed` follows at once and
    the rest creeps in with the retardation time `tau_s`,

        y = (1 - delayed) r + delayed z,    tau z' = r - z,

    exact for r that is straight between samples. It starts in equilibrium with values[0].
    """
    if delayed == 0 or tau_s == 0:
        return values
    forget = np.exp(-step_s / tau_s)
    held = (1 - forget) * tau_s / step_s
    state = held * values[:1]  # what makes z[0] = values[0]
    crept, _ = lfilter([1 - held, held - forget], [1, -forget], values, axis=0, zi=state)
    return (1 - delayed) * values + delayed * crept

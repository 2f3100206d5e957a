"""Outputs at rest that an accelerometer cannot have, and the unit that they look like."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from softslide.features.stream.drift import measures_gravity

STANDARD_GRAVITY = 9.80665  # m/s2
# Beyond the supply by this share no output is possible, not even of a supply that is off.
BEYOND = 0.1
# What one of each unit is in V, where the output is a voltage.
VOLTS = {"mV": 1e-3, "uV": 1e-6}
# Of a converter that reads the supply: its bits.
BITS = (8, 10, 12, 14, 16, 18, 24)
# What one of each unit is in g.
ACCELERATIONS = {"g": 1.0, "m/s2": 1.0 / STANDARD_GRAVITY, "mg": 1e-3}
# A board at rest reads 1 g within this, g: zeros of such parts are off by a tenth of a g each.
NEAR_G = 0.3


def impossible_output(rest: np.ndarray, accelerometer: Mapping[str, Any]) -> str:
    """Why outputs at rest (3,), in what is taken for V, cannot be this accelerometer's; "" where they can.

    accelerometer: as in the card or sensor.toml.
    """
    if not measures_gravity(accelerometer) or not np.isfinite(rest).all():
        return ""
    zero_v, v_per_g = float(accelerometer["zero_g_v"]), float(accelerometer["sensitivity_v_per_g"])
    supply_v = 2.0 * zero_v
    at_rest_g = np.linalg.norm(rest - zero_v) / v_per_g
    outside = bool(((rest < -BEYOND * supply_v) | (rest > (1.0 + BEYOND) * supply_v)).any())
    unit = _unit_of(rest, zero_v, v_per_g)
    if not outside and (abs(at_rest_g - 1.0) <= NEAR_G or unit not in ACCELERATIONS):
        return ""
    remedy = f"they look like {unit}: name that unit in the map of 'softslide import'"
    guess = remedy if unit else "check unit and wiring"
    return (
        f"at rest {', '.join(f'{v:.4g}' for v in rest)} V, {at_rest_g:.3g} g, of an accelerometer between 0 and "
        f"{supply_v:g} V that reads 1 g; {guess}"
    )


def _unit_of(rest: np.ndarray, zero_v: float, v_per_g: float) -> str:
    """The unit in which these numbers are 1 g at rest; "" if none is."""
    counts = {f"counts of {bits} bits": 2.0 * zero_v / 2**bits for bits in BITS}
    for unit, volts in (VOLTS | counts).items():
        if abs(np.linalg.norm(volts * rest - zero_v) / v_per_g - 1.0) <= NEAR_G:
            return unit
    for unit, one_g in ACCELERATIONS.items():
        if abs(np.linalg.norm(one_g * rest) - 1.0) <= NEAR_G:
            return unit
    return ""

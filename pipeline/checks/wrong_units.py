"""Outputs and speeds that physics does not allow, and the unit that they look like."""

import numpy as np
import pandas as pd

from pipeline.sensor import STANDARD_GRAVITY, Accelerometer, Sensor

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
# What one of each unit is in mm/s.
SPEEDS = {"cm/s": 10.0, "m/s": 1000.0, "mm/min": 1 / 60}
# A slide's travel over its duration is its speed within this share: stages take their time to speed up and to stop.
NEAR_SPEED = 0.2


def impossible_output(rest: np.ndarray, part: Accelerometer) -> str:
    """Why outputs at rest (3,), in what is taken for V, cannot be this accelerometer's; "" where they can."""
    supply_v = 2.0 * part.zero_g_v
    if not part.measures_gravity or not np.isfinite(rest).all():
        return ""
    at_rest_g = np.linalg.norm(rest - part.zero_g_v) / part.sensitivity_v_per_g
    outside = bool(((rest < -BEYOND * supply_v) | (rest > (1.0 + BEYOND) * supply_v)).any())
    unit = _unit_of(rest, part)
    if not outside and (abs(at_rest_g - 1.0) <= NEAR_G or unit not in ACCELERATIONS):
        return ""
    guess = f"they look like {unit}: name that unit in the import map" if unit else "check unit and wiring"
    return (
        f"at rest {', '.join(f'{v:.4g}' for v in rest)} V, {at_rest_g:.3g} g, of an accelerometer between 0 and "
        f"{supply_v:g} V that reads 1 g; {guess}"
    )


def _unit_of(rest: np.ndarray, part: Accelerometer) -> str:
    """The unit in which these numbers are 1 g at rest; "" if none is."""
    counts = {f"counts of {bits} bits": 2.0 * part.zero_g_v / 2**bits for bits in BITS}
    for unit, volts in (VOLTS | counts).items():
        g = np.linalg.norm(volts * rest - part.zero_g_v) / part.sensitivity_v_per_g
        if abs(g - 1.0) <= NEAR_G:
            return unit
    for unit, one_g in ACCELERATIONS.items():
        if abs(np.linalg.norm(one_g * rest) - 1.0) <= NEAR_G:
            return unit
    return ""


def impossible_speed(manifest: pd.DataFrame, sensor: Sensor) -> tuple[float, str]:
    """How many times the way of speed and moments of motion the way was, the median, and why that is wrong; "" if not.

    The way is `travel_mm`; where no recording says, it is the chamber's width, which slides cross.
    """
    duration = manifest["motion_end_s"] - manifest["motion_start_s"]
    ratio = (manifest["travel_mm"] / (manifest["speed_mm_s"] * duration)).dropna()
    near, way = NEAR_SPEED, "travel_mm"
    if ratio.empty:
        ratio = (np.mean(sensor.chamber_mm) / (manifest["speed_mm_s"] * duration)).dropna()
        # A slide may cross less than half of the chamber, or begin well outside it.
        near, way = 1.2, "the chamber's width"
    if ratio.empty:
        return 1.0, ""
    factor = float(ratio.median())
    if abs(np.log(factor)) <= 1.5 * near:
        return 1.0, ""
    units = [unit for unit, mm_s in SPEEDS.items() if abs(np.log(factor / mm_s)) <= near]
    guess = " or ".join(units)
    remedy = f"they look like {guess}: convert them to mm/s" if guess else "check speeds and moments"
    return factor, f"times the way that speed_mm_s and the moments of motion give is {way}; {remedy}"

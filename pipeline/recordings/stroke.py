"""The stage's motion along its line: it speeds up at a constant rate, cruises, and slows down at the same rate."""

import numpy as np

LEAST_RAMP_S = 1e-6  # for labels that leave no time for a ramp


def stage_motion(
    since_s: np.ndarray, travel_mm: float, speed_mm_s: float, duration_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Travelled distance (n,) mm and speed (n,) mm/s at (n,) s since the motion began.

    The speed is a trapezoid of area L = travel_mm and height v = speed_mm_s, so the duration T sets both ramps:
    T = L / v + ramp. Before the motion the distance is 0, after it L. A stroke shorter than its ramps (L / v < ramp)
    takes L / v to speed up and never reaches v: its trapezoid is L / ramp high.
    """
    ramp = max(duration_s - travel_mm / speed_mm_s, LEAST_RAMP_S)
    if ramp > travel_mm / speed_mm_s:
        ramp, speed_mm_s = travel_mm / speed_mm_s, travel_mm / ramp
    t = np.clip(since_s, 0.0, duration_s)
    speed = speed_mm_s * np.clip(np.minimum(t, duration_s - t) / ramp, 0.0, 1.0)
    travelled = np.where(t < ramp, speed_mm_s * t**2 / (2 * ramp), speed_mm_s * (t - ramp / 2))
    late = t > duration_s - ramp
    travelled[late] = travel_mm - speed_mm_s * (duration_s - t[late]) ** 2 / (2 * ramp)
    return travelled, speed

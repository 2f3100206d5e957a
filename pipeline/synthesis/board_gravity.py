"""Gravity that boards read in a tilted sensor, from their posture in a level one."""

import numpy as np


def upright(tilt_deg: tuple[float, float]) -> np.ndarray:
    """The upward unit vector (3,) in the frame of a sensor tilted towards x and towards y by these angles."""
    x, y = np.sin(np.deg2rad(tilt_deg))
    if (left := 1 - x**2 - y**2) < 0:
        raise ValueError(f"tilts of {tilt_deg[0]:g} and {tilt_deg[1]:g} degrees are impossible together")
    return np.array([-x, -y, np.sqrt(left)])


def in_tilted_sensor(tilt_g: np.ndarray, yaw_rad: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Gravity (boards, 3, n) g that the boards read.

    A board's rotation R in the sensor is known from what it reads in a level one, r = S R^T e_z with
    S = diag(-1, -1, 1) (see `pipeline.skin.solved_line.gravity`), and from its yaw about the skin's normal:
    R = Rz(yaw) Ry(p) Rx(q), sin p = r_x, sin q = -r_y / cos p. In a sensor where up is u it reads S R^T u.

    Args:
        tilt_g: (boards, 2, n) r_x and r_y. yaw_rad: (boards, n). up: (3,), see `upright`.
    """
    sin_p, r_y = tilt_g[:, 0], tilt_g[:, 1]
    cos_p = np.sqrt(1 - sin_p**2)
    sin_q = -r_y / cos_p
    cos_q = np.sqrt(1 - sin_q**2)
    # Rz^T u, then Ry^T, then Rx^T.
    x = np.cos(yaw_rad) * up[0] + np.sin(yaw_rad) * up[1]
    y = np.cos(yaw_rad) * up[1] - np.sin(yaw_rad) * up[0]
    x, z = cos_p * x - sin_p * up[2], sin_p * x + cos_p * up[2]
    y, z = cos_q * y + sin_q * z, cos_q * z - sin_q * y
    return np.stack([-x, -y, z], axis=1)

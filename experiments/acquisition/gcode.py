"""A plan as G-code, for a 3-D printer (Marlin) or a small CNC machine (GRBL) that moves the ball.

Never tried on hardware. The program begins where the ball just touches the skin's highest point, over the chamber's
middle, and calls this place the origin. Between slides the ball is above the skin; it goes down and up clear of it.
"""

import math
from typing import Any

import pandas as pd

from softslide.features.errors import InputError

CLEAR_MM = 10.0  # above the skin's highest point, between slides
TRAVEL_MM_S, DOWN_MM_S = 40.0, 2.0
REST_S = 3.0  # before and after each motion: the static output is read there
DEEPEST_MM = 2.0  # no plan goes deeper: half of the article's skin
# A pause in each dialect: seconds are S in Marlin (its P counts milliseconds), P in GRBL.
PAUSES = {"marlin": "G4 S{:g}", "grbl": "G4 P{:g}"}


def gcode(slides: pd.DataFrame, firmware: str = "marlin") -> str:
    """The program of a plan's slides, in their order: absolute places in mm from the chamber's middle, F in mm/min.

    slides: rows of `plan.COLUMNS`.

    Raises:
        InputError: an unknown firmware, or a slide without a depth or deeper than DEEPEST_MM.
    """
    if firmware not in PAUSES:
        raise InputError(f"{firmware}: name one of {', '.join(PAUSES)}", "firmware")
    rest = PAUSES[firmware].format(REST_S)
    lines = [
        "; Put the ball over the chamber's middle, just touching the skin, then start. Never tried on hardware.",
        *("G21 ; mm", "G90 ; absolute", "G92 X0 Y0 Z0 ; here", move(DOWN_MM_S, z=CLEAR_MM)),
    ]
    for row in slides.to_dict("records"):
        start, end = ends(row)
        name, depth, speed = row["recording"], row["depth_mm"], row["speed_mm_s"]
        check_depth(name, depth, "gcode")
        lines += [
            f"; {name}: {row['direction_deg']:g} deg, {speed:g} mm/s, offset {row['offset_mm']:g} mm",
            move(TRAVEL_MM_S, *start),
            move(DOWN_MM_S, z=-depth),
            rest,
            move(speed, *end),
            rest,
            move(DOWN_MM_S, z=CLEAR_MM),
        ]
    return "\n".join([*lines, move(TRAVEL_MM_S, 0.0, 0.0), "M2 ; end", ""])


def check_depth(name: object, depth_mm: float, option: str) -> None:
    """Sees that a slide, by its name, has a depth that may be driven. option: the parameter that asks for it.

    Raises:
        InputError: it has not.
    """
    if not 0 <= depth_mm <= DEEPEST_MM:
        raise InputError(f"{name}: depth {depth_mm:g} mm; at most {DEEPEST_MM:g} is driven", option)


def ends(slide: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where a slide, a row of a plan by name, begins and ends: x and y in mm."""
    x, y, angle = slide["start_x_mm"], slide["start_y_mm"], math.radians(slide["direction_deg"])
    return (x, y), (x + slide["travel_mm"] * math.cos(angle), y + slide["travel_mm"] * math.sin(angle))


def move(speed_mm_s: float, x: float | None = None, y: float | None = None, z: float | None = None) -> str:
    """A straight move at a speed to an absolute place in mm; what is not given stays."""
    place = "".join(
        f" {axis}{v + 0.0:.3f}" for axis, v in zip("XYZ", (x, y, z), strict=True) if v is not None
    )
    return f"G1{place} F{60 * speed_mm_s:g}"

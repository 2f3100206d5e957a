"""A plan as G-code, for a 3-D printer (Marlin) or a small CNC machine (GRBL) that moves the ball.

Never tried on hardware. The program begins over the chamber's middle where the ball just touches the skin while the
pressure is off, and calls this place the origin: depths are below the flat skin's face. It lifts the ball and waits for
the pressure. Between slides the ball is above the inflated skin; it goes down and up clear of it.
"""

import math
from typing import Any

import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.sensor import Sensor

# What a stage is set to, and how long the motion takes.
NEEDED = ("direction_deg", "speed_mm_s", "start_x_mm", "start_y_mm", "travel_mm")
CLEAR_MM = 20.0  # above the flat skin's face, between slides
HIGHEST_MM = 15.0  # no skin that stands higher, inflated, is driven over
TRAVEL_MM_S, DOWN_MM_S = 40.0, 2.0
REST_S = 3.0  # before and after each motion: the static output is read there
DEEPEST_MM = 2.0  # no plan goes deeper: half of the article's skin
FIRMWARE = ("marlin", "grbl")
WAIT = "M0"  # until the operator goes on, in both


def gcode(slides: pd.DataFrame, firmware: str = "marlin") -> str:
    """The program of a plan's slides, in their order: absolute places in mm from the chamber's middle, F in mm/min.

    slides: rows of `plan.COLUMNS`.

    Raises:
        InputError: an unknown firmware, or a slide without a depth or deeper than DEEPEST_MM.
    """
    if firmware not in FIRMWARE:
        raise InputError(f"{firmware}: name one of {', '.join(FIRMWARE)}", "firmware")
    rest = pause(firmware, REST_S)
    lines = [
        "; Pressure off: put the ball over the chamber's middle, just touching the skin, then start.",
        "; It lifts the ball and waits: turn the pressure on and let it settle, then go on. Never tried on hardware.",
        *("G21 ; mm", "G90 ; absolute", "G92 X0 Y0 Z0 ; here", move(DOWN_MM_S, z=CLEAR_MM), WAIT),
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


def check_height(sensor: Sensor, option: str) -> None:
    """Sees that a sensor's inflated skin is lower than the ball's way between slides.

    Raises:
        InputError: it is not.
    """
    if sensor.skin and (height := max(sensor.skin.height_mm, default=0.0)) > HIGHEST_MM:
        raise InputError(f"the skin stands {height:g} mm high; at most {HIGHEST_MM:g} is driven over", option)


def ends(slide: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where a slide, a row of a plan by name, begins and ends: x and y in mm."""
    x, y, angle = slide["start_x_mm"], slide["start_y_mm"], math.radians(slide["direction_deg"])
    return (x, y), (x + slide["travel_mm"] * math.cos(angle), y + slide["travel_mm"] * math.sin(angle))


def pause(firmware: str, seconds: float) -> str:
    """A rest once all motion before it has ended; Marlin counts milliseconds."""
    return f"G4 P{1000 * seconds:.0f}" if firmware == "marlin" else f"G4 P{seconds:g}"


def move(speed_mm_s: float, x: float | None = None, y: float | None = None, z: float | None = None) -> str:
    """A straight move at a speed to an absolute place in mm; what is not given stays."""
    place = "".join(
        f" {axis}{v + 0.0:.3f}" for axis, v in zip("XYZ", (x, y, z), strict=True) if v is not None
    )
    return f"G1{place} F{60 * speed_mm_s:g}"

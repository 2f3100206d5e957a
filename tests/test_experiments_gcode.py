"""A plan as G-code, driven: each slide is where, whither and how fast the plan says, and nothing else touches."""

import re
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from softslide.experiments.acquisition.gcode import (
    CLEAR_MM,
    DEEPEST_MM,
    HIGHEST_MM,
    REST_S,
    WAIT,
    check_height,
    gcode,
)
from softslide.experiments.acquisition.plan import COLUMNS, DIRECTIONS_DEG, _lines
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import SAMPLE, read_folder

SENSOR = read_folder(SAMPLE).sensor
PLAN = _lines(SENSOR, DIRECTIONS_DEG, 1.0, 0.5).sample(40, random_state=0)
PLAN = PLAN.assign(recording=[f"p{n}" for n in range(len(PLAN))], speed_mm_s=20 * [1.0, 4.0])[list(COLUMNS)]


def driven(program: str, firmware: str) -> Iterator[tuple[np.ndarray, np.ndarray, float]]:
    """Moves (from, to, mm/s) and rests (same place, s), as a machine reads them."""
    place = np.zeros(3)
    for line in program.splitlines():
        words = dict(re.findall(r"([A-Z])(-?[\d.]+)", line.partition(";")[0]))
        if words.get("G") == "92":
            place = np.zeros(3)
        elif words.get("G") == "1":
            to = np.array([float(words.get(axis, at)) for axis, at in zip("XYZ", place, strict=True)])
            yield place, to, float(words["F"]) / 60
            place = to
        elif words.get("G") == "4":
            yield place, place, float(words["P"]) / (1000 if firmware == "marlin" else 1)


@pytest.mark.parametrize("firmware", ["marlin", "grbl"])
def test_each_slide_is_driven_as_planned_and_nothing_else_touches(firmware: str) -> None:
    slides, rests, lowest = [], [], 0.0
    reach = np.array(SENSOR.chamber_mm) / 2 + SENSOR.indenter_diameter_mm / 2
    for start, end, speed in driven(gcode(PLAN, firmware), firmware):
        lowest = min(lowest, end[2])
        if (start == end).all():
            rests.append(speed)
        elif (start[:2] == end[:2]).all():
            # Down and up clear of the chamber, or at the origin at the beginning.
            assert (np.abs(end[:2]) > reach).any() or (start == 0).all()
        elif min(start[2], end[2]) < CLEAR_MM:
            slides.append((start, end, speed))
    assert rests == [REST_S] * 2 * len(PLAN)
    # The ball has left the flat skin before the operator is asked for the pressure.
    before, _, _ = gcode(PLAN, firmware).partition(f"\n{WAIT}\n")
    assert before.endswith(f"Z{CLEAR_MM:.3f} F120")
    assert lowest == -0.5
    for (start, end, speed), row in zip(slides, PLAN.itertuples(), strict=True):
        way = (end - start)[:2]
        turned = np.degrees(np.arctan2(way[1], way[0])) - row.direction_deg
        assert abs((turned + 180) % 360 - 180) < 0.01
        assert np.hypot(*way) == pytest.approx(row.travel_mm, abs=2e-3)
        assert start == pytest.approx([row.start_x_mm, row.start_y_mm, -row.depth_mm], abs=1e-3)
        assert end[2] == start[2]
        assert speed == pytest.approx(row.speed_mm_s)


@pytest.mark.parametrize("depth", [DEEPEST_MM + 0.1, -0.1, np.nan])
def test_what_no_plan_may_drive_is_refused(depth: float) -> None:
    with pytest.raises(InputError, match=r"p3: depth"):
        gcode(PLAN.assign(depth_mm=[0.5, 0.5, 0.5, depth, *[0.5] * (len(PLAN) - 4)]))
    with pytest.raises(InputError, match="name one of marlin, grbl"):
        gcode(PLAN, "reprap")


def test_a_skin_that_stands_higher_than_the_ball_travels_is_refused() -> None:
    skin = replace(SENSOR.skin, height_mm=(HIGHEST_MM + 1.0,))
    with pytest.raises(InputError, match="stands 16 mm high; at most 15"):
        check_height(replace(SENSOR, skin=skin), "gcode")

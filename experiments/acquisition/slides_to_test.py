"""Slides to test with: along lines that no slide to learn from takes, some for each of the article's bounds."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.bounds import Bound, read_bounds
from softslide.features.errors import InputError
from softslide.models.design.line_information import LEAST_CHORD_MM
from softslide.pipeline.recordings.learned import learned_lines
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.slide_plan import crossing

DRAWS = 500
# Of lines in any direction, from the reference point, in shares of the chamber's shorter side: the article's detectable
# area of X-slides is 17.5 mm of 50 (section 5.2.2, figure 23).
DETECTABLE = 0.35


def draw_tests(
    count: int,
    learned: pd.DataFrame,
    sensor: Sensor,
    directions_deg: Sequence[float],
    speeds_mm_s: Sequence[float],
    depth_mm: float,
) -> pd.DataFrame:
    """Slides of the split `test`, the same for the same design: for each bound in turn one that it is of, and after it
    one in any direction. A bound that no line of the stage is of has none.

    learned: the slides to learn from, in whose columns they are. directions_deg: of the stage. speeds_mm_s: its, drawn
    from the lowest to the highest.

    Raises:
        InputError: there is no such line over the chamber.
    """
    random, bounds = np.random.default_rng(7), read_bounds()
    rows: list[dict[str, object]] = []
    for number in range(count):
        wanted = (None, bounds[number // 2 % len(bounds)])[number % 2 == 0]
        drawn = (
            _draw(random, of, learned, sensor, directions_deg, speeds_mm_s)
            for of in (wanted, None)
            for _ in range(DRAWS)
        )
        row = next((row for row in drawn if row is not None), None)
        if row is None:
            raise InputError(
                "no line next to those of the slides crosses the chamber; take more directions", "tests"
            )
        rows.append({"recording": f"t{number + 1:02d}", "split": "test", **row, "depth_mm": depth_mm})
    return pd.DataFrame(rows, columns=learned.columns).round(3)


def _draw(
    random: np.random.Generator,
    bound: Bound | None,
    learned: pd.DataFrame,
    sensor: Sensor,
    directions_deg: Sequence[float],
    speeds_mm_s: Sequence[float],
) -> dict[str, float] | None:
    """One line's labels, or None where it is not of the bound, is that of a slide, or misses the chamber."""
    direction = float(random.choice(directions_deg)) % 360.0
    distance, speed = (0.0, DETECTABLE * min(sensor.chamber_mm)), (min(speeds_mm_s), max(speeds_mm_s))
    if bound is not None:
        area = bound.area_mm(direction)
        speed = max(speed[0], bound.speed_mm_s[0]), min(speed[1], bound.speed_mm_s[1])
        if area is None or speed[0] > speed[1]:
            return None
        distance = area
    offset = round(float(random.choice((-1.0, 1.0)) * random.uniform(*distance)), 1)
    line = crossing(direction, offset, sensor)
    if line is None or line[2] < LEAST_CHORD_MM:
        return None
    (x, y), travel, _ = line
    row = {"direction_deg": direction, "offset_mm": offset}
    row |= {"start_x_mm": x, "start_y_mm": y, "travel_mm": travel}
    both = pd.concat([learned, pd.DataFrame([{"split": "test", **row}])], ignore_index=True)
    if learned_lines(both).iloc[-1]:
        return None
    return row | {"speed_mm_s": round(float(np.exp(random.uniform(*np.log(speed)))), 2)}

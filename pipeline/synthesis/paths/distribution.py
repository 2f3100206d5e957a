"""What synthetic paths are like: a documented distribution."""

from dataclasses import dataclass

from softslide.pipeline.ranges import check_pairs, check_positive


@dataclass(frozen=True)
class PathDistribution:
    """Of paths. Pairs are bounds of a uniform draw unless said otherwise.

    Courses: `radius_mm` (log-uniform) of arcs and S-curves, `circle_mm` of circles, `corner_deg` of corners,
    `bend_mm`: least radius of random smooth curves, which bend on a scale of `wave_mm`. At least `chord_mm` of a course
    that crosses the rim lies over the chamber. Courses that begin or end on the skin do so within `inner_share` of
    the chamber's half width; `on_skin_mm` is their way there.
    Motion: `speed_mm_s` (log-uniform), `ramp_s` to reach it; `quick_mm_s` is reached from `slow_mm_s` and left again
    by paths of changing speed, half of them at constant acceleration, half on a random smooth profile between the two
    with `changes` maxima. `stop_s` a stop lasts, `turn_s` one at a turn back.
    Touch: half of the touch-downs and lifts are vertical, at `fall_mm_s` (log-uniform) with a rest of `settle_s`; the
    others come or go along `slant_mm`. `hold_s` a press lasts. `change_mm`: half the change of depth along the way,
    up or down. `friction_mm`: way over which friction follows the motion.
    """

    radius_mm: tuple[float, float] = (15.0, 60.0)
    circle_mm: float = 8.0
    corner_deg: tuple[float, float] = (40.0, 120.0)
    bend_mm: float = 12.0
    wave_mm: tuple[float, float] = (25.0, 60.0)
    chord_mm: float = 25.0
    inner_share: float = 0.7
    on_skin_mm: float = 12.0
    speed_mm_s: tuple[float, float] = (0.8, 8.0)
    ramp_s: tuple[float, float] = (0.02, 0.2)
    slow_mm_s: tuple[float, float] = (0.8, 1.2)
    quick_mm_s: tuple[float, float] = (5.0, 7.0)
    changes: tuple[float, float] = (1.0, 4.0)
    stop_s: float = 0.8
    turn_s: tuple[float, float] = (0.0, 0.5)
    fall_mm_s: tuple[float, float] = (2.0, 10.0)
    settle_s: tuple[float, float] = (0.0, 0.5)
    slant_mm: tuple[float, float] = (4.0, 15.0)
    hold_s: tuple[float, float] = (0.5, 2.0)
    change_mm: tuple[float, float] = (0.25, 0.5)
    friction_mm: tuple[float, float] = (0.25, 0.45)
    before_s: tuple[float, float] = (1.5, 3.0)
    after_s: tuple[float, float] = (2.0, 3.0)

    def __post_init__(self) -> None:
        check_pairs(self, least=0.0)
        check_positive(self, "radius_mm", "speed_mm_s", "slow_mm_s", "quick_mm_s", "fall_mm_s", "ramp_s")

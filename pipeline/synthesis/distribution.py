"""What synthetic slides are like: a documented distribution, and slides drawn from it."""

from dataclasses import dataclass, field

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.ranges import check_pairs, check_positive, check_ranges
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.electronics import ElectronicsSpread
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.slide_plan import Slide, crossing, near_failure, on_line

# The splits of ten successive slides, again and again, so that the first slides of a longer folder are those of a
# shorter one and few slides already have something to be tested on.
SPLITS = (
    *("calibration", "calibration-diagonal", "test", "calibration", "test-diagonal"),
    *("calibration", "calibration", "calibration-diagonal", "test", "calibration"),
)
# Lines to learn from lie on a scale, as a lab sets them; lines to test lie between its marks.
SCALE_MM = 0.5
_BETWEEN = (0.2, 0.8)
_DRAWS = 200


@dataclass(frozen=True)
class Distribution:
    """Of slides and of the specimen that they are made with. Pairs are bounds of a uniform draw unless said otherwise.

    Lines: `offset_mm`, from the sensor's reference point; lines with less than `chord_mm` over the chamber are drawn
    again. Slides along the axes for the splits that are not called diagonal, any direction for the others.
    Motion: `speed_mm_s` (log-uniform), `ramp_s` to reach it, rests before and after, `rest_s` (log-uniform). The share
    `stopping` of slides ends on the skin after `stop_share` of its travel and rests there; the share `turning` turns
    there after `dwell_s` and goes back; labels then describe the first stroke.
    Contact: `depth_mm`, as a stage is set; the share `uneven` of slides is off it by up to `off_mm` at the middle of
    the travel and changes by `slope_mm` (standard deviation, normal) over all of it. Depths that the atlas does not
    hold are taken to the nearest that it does. `friction_mm`: way over which friction turns with the motion.
    Skin: `height_mm` at the sensor's nominal pressure, None for the middle of the atlas's; a slide's pressure is
    `pressure_share` of the nominal one (of an atlas of one height: the nominal one) and the height goes with its cube
    root. `repeatability`: standard deviation of a slide's response about the atlas's. `delayed`, `tau_s`
    (log-uniform): the skin's lag.
    Disturbances: `posture_deg`, standard deviation of the sensor's tilt, slide by slide. `vibration_g`
    (log-uniform) while the surfaces slide at 10 mm/s, rising with the root of the speed, at `vibration_hz`. `ripple`
    (log-uniform): relative amplitude of the pressure's, at `ripple_hz` (log-uniform). `drift_g`: standard deviation
    of each output's drift in a minute.
    """

    offset_mm: tuple[float, float] = (-17.5, 17.5)
    chord_mm: float = 25.0
    speed_mm_s: tuple[float, float] = (0.5, 13.0)
    ramp_s: tuple[float, float] = (0.02, 0.2)
    rest_s: tuple[float, float] = (0.5, 20.0)
    stopping: float = 0.05
    turning: float = 0.05
    stop_share: tuple[float, float] = (0.35, 0.9)
    dwell_s: tuple[float, float] = (0.0, 3.0)
    depth_mm: float = 0.5
    uneven: float = 0.4
    off_mm: float = 0.1
    slope_mm: float = 0.1
    friction_mm: float = 0.3
    height_mm: float | None = None
    pressure_share: tuple[float, float] = (0.99, 1.01)
    repeatability: float = 0.02
    delayed: tuple[float, float] = (0.05, 0.2)
    tau_s: tuple[float, float] = (0.05, 0.5)
    posture_deg: float = 1.0
    vibration_g: tuple[float, float] = (0.001, 0.005)
    vibration_hz: tuple[float, float] = (60.0, 180.0)
    ripple: tuple[float, float] = (0.0005, 0.003)
    ripple_hz: tuple[float, float] = (0.2, 3.0)
    drift_g: float = 0.001
    electronics: ElectronicsSpread = field(default_factory=ElectronicsSpread)

    def __post_init__(self) -> None:
        check_pairs(self)
        check_positive(
            self, "speed_mm_s", "rest_s", "tau_s", "vibration_g", "ripple", "ripple_hz", "pressure_share"
        )
        if not 0 <= self.stopping + self.turning <= 1:
            raise ValueError(f"stopping and turning are {self.stopping + self.turning} together; at most 1")
        check_ranges(self, stop_share=(0.1, 1.0))

    def nominal_height_mm(self, atlas: Atlas) -> float:
        """The skin's height at the sensor's nominal pressure."""
        return float(np.median(atlas.height_mm)) if self.height_mm is None else self.height_mm


def draw_slide(
    number: int, atlas: Atlas, sensor: Sensor, distribution: Distribution, random: np.random.Generator
) -> Slide:
    """The plan of slide `number`, counted from 0.

    Raises:
        InputError: no line fits, or as `draw_pressure`.
    """
    d = distribution
    split = SPLITS[number % len(SPLITS)]
    for _ in range(_DRAWS):
        direction, offset = _draw_line(split, d, random)
        line = crossing(direction, offset, sensor)
        if line is None or line[2] < d.chord_mm:
            continue
        start, whole, _ = line
        if not near_failure(atlas, *on_line(start, direction, np.arange(0, whole, 0.5))):
            break
    else:
        raise InputError(
            f"no line of offset {d.offset_mm[0]:g}..{d.offset_mm[1]:g} mm crosses {d.chord_mm:g} mm of the chamber "
            "over solved positions; widen offset_mm or lower chord_mm"
            + ("" if atlas.valid.all() else ", or solve the atlas at lower [skin] height_mm")
        )
    speed = log_uniform(random, d.speed_mm_s)
    end = random.uniform()
    travel = whole * (random.uniform(*d.stop_share) if end < d.stopping + d.turning else 1.0)
    # A ramp never takes more than a quarter of the stroke, so that the speed is reached.
    ramp = min(random.uniform(*d.ramp_s), 0.25 * travel / speed)
    dwell = random.uniform(*d.dwell_s)
    turns = d.stopping <= end < d.stopping + d.turning
    stroke = Stroke(travel, speed, ramp, travel if turns else 0.0, dwell if turns else 0.0)
    depth, slope = _draw_depth(atlas, d, whole, travel, random)
    share, height = draw_pressure(atlas, d, random)
    posture = d.posture_deg * random.standard_normal(2)
    return Slide(
        direction,
        offset,
        start,
        stroke,
        depth,
        sensor.pressure_mpa * share,
        height,
        depth_slope=slope,
        name=f"s{number:05d}",
        split=split,
        motion_start_s=log_uniform(random, d.rest_s),
        rest_after_s=log_uniform(random, d.rest_s),
        posture_deg=(float(posture[0]), float(posture[1])),
        gain=1 + d.repeatability * random.standard_normal(),
    )


def draw_pressure(atlas: Atlas, d: Distribution, random: np.random.Generator) -> tuple[float, float]:
    """A pressure over the nominal one, and the skin's height in mm at it.

    Raises:
        InputError: the distribution asks for a height that the atlas does not hold.
    """
    share = random.uniform(*d.pressure_share) if len(atlas.height_mm) > 1 else 1.0
    height = float(d.nominal_height_mm(atlas) * np.cbrt(share))
    if not atlas.height_mm[0] - 1e-6 <= height <= atlas.height_mm[-1] + 1e-6:
        raise InputError(
            f"a skin height of {height:.3g} mm is outside the atlas's {atlas.height_mm[0]:.3g}.."
            f"{atlas.height_mm[-1]:.3g} mm; change height_mm or pressure_share"
        )
    return share, height


def _draw_line(split: str, d: Distribution, random: np.random.Generator) -> tuple[float, float]:
    """Direction in degrees and offset in mm."""
    offset = random.uniform(*d.offset_mm)
    if split.endswith("diagonal"):
        return float(random.uniform(0, 360)), float(offset)
    between = random.uniform(*_BETWEEN) if split.startswith("test") else 0.0
    return 90.0 * float(random.integers(4)), SCALE_MM * (np.floor(offset / SCALE_MM) + between)


def _draw_depth(
    atlas: Atlas, d: Distribution, whole: float, travel: float, random: np.random.Generator
) -> tuple[float, float]:
    """Depth at the middle of a stroke, and its slope along the way, so that both ends stay within the atlas."""
    off, change = d.off_mm * random.uniform(-1, 1), d.slope_mm * random.standard_normal() * travel / whole
    if random.uniform() >= d.uneven:
        off = change = 0.0
    depth = float(np.clip(d.depth_mm + off, atlas.depth_mm[0], atlas.depth_mm[-1]))
    room = 2 * min(depth - atlas.depth_mm[0], atlas.depth_mm[-1] - depth)
    return depth, float(np.clip(change, -room, room)) / travel


def log_uniform(random: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A draw between the bounds, its logarithm uniform."""
    return float(np.exp(random.uniform(*np.log(bounds))))

"""The atlas as a prior: the design's response map, its parameters fitted to a few recordings of the sensor.

A sensor differs from its design by the skin's height, each board's place, rotation and gain, and friction. These few
numbers are fitted with priors of their own: four recordings already correct them, and without any they stay the
design's.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from scipy.optimize import least_squares

from softslide.models.response_map.map import (
    PARTS,
    ResponseMap,
    half_of,
    spline_coefficients,
    spline_grid,
    tensor_splines,
)
from softslide.models.response_map.slides import CalibrationSlide, at_height, main_height_mm, several
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.ranges import SIZE, check_ranges
from softslide.pipeline.sensor import Sensor

DEPTH_STEP_MM = 0.1  # of the central difference over depth
HEIGHT_STEP_MM = 0.5  # and over the skin's height, about what recordings at several pressures differ by
SAMPLE_MM = 2.0  # between the stretches used; neighbours say the same
MOST_SLIDES = 24  # a few parameters need no more; the fit's time grows with them
# Independent pieces of evidence in a slide: the residuals of neighbouring stretches are alike.
PIECES = 8.0
# Residual of a design's map on a sensor that nothing is known of: with 10 mg instead of 5 the distance error on
# bench-a's calibration lines fell from 0.46 to 0.35 mm (experiments/LOG.md).
DESIGN_RESIDUAL_G = 0.01
# Of it, what is alike everywhere along a slide.
DESIGN_LEVEL_SHARE = 0.6
# Noise of a block, zero, drift and gain before any recording: of the article's sensor (0.8 V/g), as calibrations find
# them; the drift is what the synthesis draws, 1 mg a minute.
DESIGN_NOISE_V, DESIGN_ZERO_V, DESIGN_DRIFT_V_S, DESIGN_GAIN_SD = 1.4e-3, 7e-4, 1.3e-5, 0.1
# How near to the rim the skin moves as it does further in: 16 is as good as 32 and better than 8 (experiments/LOG.md).
RIM_POWER = 16
COMMON = 4  # parameters that all boards share: height, friction, lag, width


@dataclass(frozen=True)
class SensorSpread:
    """How a sensor differs from its design: standard deviations, and two means that are not the design's.

    gain: of a board's log gain; turn_rad, place_mm: of a board's rotation and place; friction: relative; lag_s: of the
    skin's lag. height_mm: the skin's height, mean and deviation. width: the logarithm of the response's reach around a
    board over that of the solved design, mean and deviation. misfit: the residual of the fitted design, as a share of
    the largest output. depth_change: the change with contact depth is the first number times the design's, plus the
    second times the response, 1/mm.

    The means come from the calibration lines of two emulated benches with different chambers, which agree: responses
    reach 11 and 14 % further than solved, at heights of 7.2 and 8.1 mm; those of the change with depth from one of
    them (experiments/LOG.md).
    """

    gain: float = 0.25
    turn_rad: float = 0.05
    place_mm: float = 1.0
    friction: float = 0.5
    lag_s: float = 0.02
    height_mm: tuple[float, float] = (7.5, 1.0)
    width: tuple[float, float] = (0.11, 0.05)
    misfit: float = 0.05
    depth_change: tuple[float, float] = (1.75, -0.07)

    def __post_init__(self) -> None:
        sizes = ("gain", "turn_rad", "place_mm", "friction", "lag_s", "misfit", "height_mm")
        check_ranges(self, **dict.fromkeys(sizes, SIZE), width=(-100.0, 100.0), depth_change=(-1e6, 1e6))


def tilt_v_per_g(sensor: Sensor) -> np.ndarray:
    """(C,) V/g of V_x and V_y of each accelerometer."""
    return np.repeat([a.sensitivity_v_per_g for a in sensor.accelerometers], 2)


def depth_slope(atlas: Atlas, depth_mm: float, values: Callable[[float], np.ndarray]) -> np.ndarray:
    """The change of values with the contact depth, by a central difference within the atlas."""
    ends = [depth_mm - DEPTH_STEP_MM, depth_mm + DEPTH_STEP_MM]
    low, high = np.clip(ends, atlas.depth_mm[0], atlas.depth_mm[-1]).tolist()
    below, above = values(low), values(high)
    return (above - below) / (high - low) if high > low else np.zeros_like(below)


def design_map(atlas: Atlas, sensor: Sensor, height_mm: float, depth_mm: float) -> ResponseMap:
    """The response map (V) that the atlas gives for a skin height and a contact depth, both within the atlas."""
    half = half_of(sensor.chamber_mm)
    x, y = spline_grid(half)
    level = atlas.pressure_at(height_mm)
    volts_per_g = tilt_v_per_g(sensor)

    def tilt(heading_deg: float | None, depth: float) -> np.ndarray:
        g = np.nan_to_num(atlas.response(x, y, heading_deg, depth, level))[:, :, :2]
        return g.reshape(len(x), -1) * volts_per_g

    mean = tilt(None, depth_mm)
    along_x, along_y = tilt(0.0, depth_mm) - mean, tilt(90.0, depth_mm) - mean
    slope = depth_slope(atlas, depth_mm, lambda depth: tilt(None, depth))
    surfaces = [spline_coefficients(values, half) for values in (mean, along_x, along_y, slope)]
    channels = mean.shape[1]
    floor_v = DESIGN_RESIDUAL_G * float(np.mean([a.sensitivity_v_per_g for a in sensor.accelerometers]))
    return ResponseMap(
        np.stack(surfaces[:3]),
        surfaces[3],
        sensor.chamber_mm,
        sensor.reference_mm,
        depth_mm=depth_mm,
        noise_v=np.full(channels, DESIGN_NOISE_V),
        zero_v=np.full(channels, DESIGN_ZERO_V),
        drift_v_s=np.full(channels, DESIGN_DRIFT_V_S),
        floor_v=floor_v,
        level_v=DESIGN_LEVEL_SHARE * floor_v,
        gain_sd=DESIGN_GAIN_SD,
    )


def prior_map(
    atlas: Atlas, sensor: Sensor, slides: list[CalibrationSlide], depth_mm: float, spread: SensorSpread
) -> tuple[ResponseMap, dict[str, float]]:
    """The design's map with its parameters fitted to the slides, by least squares with priors; and the parameters.

    Without slides the parameters are the means of the spread. Slides of several heights of the skin: they are fitted to
    those of the height that most have, and the map has the design's change with height.
    """
    family = _Family(atlas, sensor, depth_mm, spread)
    p = family.centre
    over_heights = several(slides, "height")
    if over_heights:
        height_mm = main_height_mm(slides)
        slides = list(compress(slides, at_height(slides, height_mm)))
    if slides:
        slides = slides[:: max(1, len(slides) // MOST_SLIDES)]
        peak = max(float(np.abs(s.volts).max()) for s in slides)

        def residuals(p: np.ndarray) -> np.ndarray:
            errors = [
                np.ravel((volts - s.volts)[:: _every(s)])
                for volts, s in zip(family.predicted(p, slides), slides, strict=True)
            ]
            scale = spread.misfit * peak * np.sqrt(sum(len(v) for v in errors) / (PIECES * len(slides)))
            counted = [v * np.sqrt(s.weight) / scale for v, s in zip(errors, slides, strict=True)]
            return np.concatenate([*counted, (p - family.centre) / family.sd])

        p = least_squares(residuals, p, x_scale=family.sd, method="trf", max_nfev=12).x
    response = family.map(p)
    if over_heights:
        response = replace(response, height_mm=height_mm, height_slope=family.height_slope(p))
    return response, family.named(p)


def prior_deviations(
    atlas: Atlas, sensor: Sensor, depth_mm: float, spread: SensorSpread
) -> tuple[ResponseMap, np.ndarray, np.ndarray]:
    """The prior's mean map, and by how much its coefficients (P, 3, K, K, C) V and its lag (P,) s change when each
    parameter moves by its standard deviation."""
    family = _Family(atlas, sensor, depth_mm, spread)
    centre = family.centre
    ends = [(family.map(centre + step), family.map(centre - step)) for step in np.diag(family.sd)]
    changes = np.array([(above.coefficients - below.coefficients) / 2 for above, below in ends])
    lags_s = np.array([(above.lag_s - below.lag_s) / 2 for above, below in ends])
    return family.map(centre), changes, lags_s


def _every(slide: CalibrationSlide) -> int:
    """Take one stretch in so many: a couple of millimetres apart."""
    step = float(np.median(np.diff(slide.travelled_mm)))
    return max(1, round(SAMPLE_MM / max(step, 1e-3)))


class _Family:
    """The maps that a sensor of a design may have, at the contact depth of the atlas that is nearest to depth_mm.

    They depend on parameters p: height, friction, lag and width, then each board's log gain, turn and place. centre,
    sd: of p's prior.
    """

    def __init__(self, atlas: Atlas, sensor: Sensor, depth_mm: float, spread: SensorSpread) -> None:
        depth_mm = float(np.clip(depth_mm, atlas.depth_mm[0], atlas.depth_mm[-1]))
        self._sensor, self._depth_change, self._heights_mm = sensor, spread.depth_change, atlas.height_mm
        self._levels = [design_map(atlas, sensor, float(h), depth_mm) for h in atlas.height_mm]
        # At p = 0.
        self._middle_mm = float(np.clip(spread.height_mm[0], atlas.height_mm[0], atlas.height_mm[-1]))
        boards = len(sensor.accelerometers)
        self.centre = np.zeros(COMMON + 4 * boards)
        self.centre[3] = spread.width[0]
        self.sd = np.array(
            [spread.height_mm[1], spread.friction, spread.lag_s, spread.width[1]]
            + [spread.gain, spread.turn_rad, spread.place_mm, spread.place_mm] * boards
        )
        if len(atlas.height_mm) == 1:
            self.sd[0] = 1e-6

    def height_mm(self, p: np.ndarray) -> float:
        """The skin's height, within the atlas."""
        return float(np.clip(self._middle_mm + p[0], self._heights_mm[0], self._heights_mm[-1]))

    def named(self, p: np.ndarray) -> dict[str, float]:
        """The parameters p by name."""
        named = {
            "height_mm": self.height_mm(p),
            "friction": 1 + float(p[1]),
            "lag_s": float(p[2]),
            "width": float(np.exp(p[3])),
        }
        boards = self._sensor.accelerometers
        for board, (gain, turn, dx, dy) in zip(boards, p[COMMON:].reshape(-1, 4), strict=True):
            values = {"gain": np.exp(gain), "turn_deg": np.degrees(turn), "dx_mm": dx, "dy_mm": dy}
            named |= {f"{board.name}_{name}": float(value) for name, value in values.items()}
        return named

    def map(self, p: np.ndarray) -> ResponseMap:
        """The map with parameters p: splines fitted to the design's responses on a grid.

        Its change with depth is as sensors show it, not as solved.
        """
        design = self._design(p)
        x, y = spline_grid(design.half_mm)
        boards = []
        for k in range(design.channels // 2):
            one, splines = _board(design, k), tensor_splines(*self._place(x, y, k, p), design.half_mm)
            surfaces = np.stack([*one.coefficients, one.depth_slope], axis=2)
            values = (splines @ surfaces.reshape(splines.shape[1], -1)).reshape(len(x), *surfaces.shape[2:])
            boards.append(spline_coefficients(_turned(values, k, p), design.half_mm).reshape(surfaces.shape))
        moved = np.concatenate(boards, axis=-1).transpose(2, 0, 1, 3)
        factor, share = self._depth_change
        return replace(
            design, coefficients=moved[:PARTS], depth_slope=factor * moved[PARTS] + share * moved[0]
        )

    def height_slope(self, p: np.ndarray) -> np.ndarray:
        """The change (K, K, C) V/mm of M with height; zero where the atlas has one height alone."""
        low, high = (p + step * np.eye(len(p))[0] for step in (-HEIGHT_STEP_MM, HEIGHT_STEP_MM))
        apart_mm = self.height_mm(high) - self.height_mm(low)
        below, above = (self.map(q).coefficients[0] for q in (low, high))
        return (above - below) / apart_mm if apart_mm > 0 else np.zeros_like(below)

    def predicted(self, p: np.ndarray, slides: list[CalibrationSlide]) -> Iterator[np.ndarray]:
        """Output (m, C) V along each slide, predicted by the design with parameters p."""
        design = self._design(p)
        for slide in slides:
            contact, own, boards = slide.place(0.0, design.lag_s), design.at(slide.depth_mm), []
            for k in range(design.channels // 2):
                volts = _board(own, k).response(*self._place(*contact, k, p), slide.direction_rad)
                boards.append(_turned(volts, k, p))
            yield np.hstack(boards)

    def _design(self, p: np.ndarray) -> ResponseMap:
        """The design at the height, friction and lag of p: Lagrange's polynomial through the levels."""
        heights, height_mm = self._heights_mm, self.height_mm(p)
        weights = np.array([math.prod((height_mm - o) / (h - o) for o in heights if o != h) for h in heights])
        friction = np.array([1.0, 1 + p[1], 1 + p[1]])[:, None, None, None]
        coefficients = np.tensordot(weights, np.stack([level.coefficients for level in self._levels]), 1)
        slope = np.tensordot(weights, np.stack([level.depth_slope for level in self._levels]), 1)
        return replace(
            self._levels[0], coefficients=friction * coefficients, depth_slope=slope, lag_s=float(p[2])
        )

    def _place(
        self, x_mm: np.ndarray, y_mm: np.ndarray, board: int, p: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Where a contact on the design would show in the design's board as it does in this sensor's.

        Inside the chamber all is moved and drawn towards the board's home; the rim, where the skin is clamped, stays.
        """
        accelerometer = self._sensor.accelerometers[board]
        home, off = (accelerometer.x_mm, accelerometer.y_mm), p[COMMON:].reshape(-1, 4)[board, 2:]
        narrow = np.exp(-p[3])
        moved = []
        for place, at, shift, size in zip((x_mm, y_mm), home, off, self._sensor.chamber_mm, strict=True):
            inside = 1.0 - np.minimum(np.abs(place) / (size / 2), 1.0) ** RIM_POWER
            moved.append(place + inside * (at + narrow * (place - at - shift) - place))
        return moved[0], moved[1]


def _board(design: ResponseMap, k: int) -> ResponseMap:
    """One board's channels alone."""
    pair = slice(2 * k, 2 * k + 2)
    return replace(
        design, coefficients=design.coefficients[..., pair], depth_slope=design.depth_slope[..., pair]
    )


def _turned(volts: np.ndarray, board: int, p: np.ndarray) -> np.ndarray:
    """V_x, V_y (..., 2) of a board with its gain, and turned about its normal."""
    gain, turn = p[COMMON:].reshape(-1, 4)[board, :2]
    cos, sin = np.cos(turn), np.sin(turn)
    return np.exp(gain) * (volts @ np.array([[cos, -sin], [sin, cos]]))

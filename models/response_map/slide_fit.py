"""A slide next to a map: its own gain, its shift along its line, what the map leaves of it. Of many, the skin's lag.

How late the skin answers shows in slides of any speed: a map that follows the contact with a plain delay takes care of
it. How the answer is spread over time shows in fast slides alone, as features that grow wider: a standard linear solid
of the same lag, whose retardation time comes from the calibration slides as far as they go and from a prior otherwise.
It is undone in the signal (features/stream/conditioning.py), so that map, network and training need not know of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.slides import CalibrationSlide
from softslide.pipeline.ranges import POSITIVE, check_ranges
from softslide.pipeline.synthesis.viscoelastic_lag import standard_solid

# So much of a stretch's output is never explained: one step of the article's converter.
LEAST_RESIDUAL_V = 5e-4
SHIFT_STEP_MM = 0.05  # of the central difference
ITERATIONS = 2  # Gauss-Newton of two numbers that start within a few percent
TAUS_S = (0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
# The prior of the retardation time: middle and standard deviation of its logarithm, what the synthesis draws from.
TAU_S, TAU_SPREAD = 0.15, 0.6
LEAST_LAG_S = 0.004  # a fifth of a block; below this there is nothing to undo
MOST_DELAYED = 0.4  # share of the answer that may creep; the synthesis draws less
LAG_STEP_MM = 0.1  # of the difference that separates a slide's shift from its lag


@dataclass(frozen=True)
class CalibrationConfig:
    """Constants of the fit, chosen on held-out calibration lines (experiments/LOG.md).

    smooth_mean, smooth_friction: penalties on second differences, per V^2, for data in units of one block's noise.
    near_prior: penalty on the distance from an atlas's prior, likewise.
    gain_sd, shift_sd_mm: priors on each slide's own gain and place. untimed_sd_mm: on the place of a slide whose
        labels leave it out, about the first guess of onset.py.
    day_gain_sd: of the gain from one day to another, of maps without a rim: of sensing elements of which nothing but
        recordings of one day is known.
    iterations: alternations of splines and slides.
    """

    smooth_mean: float = 0.1
    smooth_friction: float = 3.0
    near_prior: float = 0.01
    gain_sd: float = 0.03
    shift_sd_mm: float = 0.1
    untimed_sd_mm: float = 2.0
    day_gain_sd: float = 0.15
    iterations: int = 4

    def __post_init__(self) -> None:
        sizes = ("smooth_mean", "smooth_friction", "near_prior", "gain_sd", "shift_sd_mm", "untimed_sd_mm")
        check_ranges(self, **dict.fromkeys(sizes, POSITIVE), day_gain_sd=POSITIVE, iterations=(1, 1000))

    def stiffened(self, times: float) -> "CalibrationConfig":
        """The same with every penalty on the map so many times as large."""
        return replace(
            self,
            smooth_mean=times * self.smooth_mean,
            smooth_friction=times * self.smooth_friction,
            near_prior=times * self.near_prior,
        )


@dataclass(frozen=True)
class SlideFit:
    """A slide with its own gain and shift along its line, and the residual (m, C) V that the map leaves."""

    slide: CalibrationSlide
    gain: float
    shift_mm: float
    residual_v: np.ndarray

    @property
    def rms_v(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.mean(self.residual_v**2)))


def fit_slide(
    slide: CalibrationSlide,
    response: ResponseMap,
    config: CalibrationConfig,
    gain: float = 1.0,
    shift_mm: float = 0.0,
) -> SlideFit:
    """A slide's gain and shift given the map, by Gauss-Newton with priors, from the gain and shift given."""
    noise = float(np.hypot(np.median(response.noise_v) / np.sqrt(slide.blocks), LEAST_RESIDUAL_V))
    shift_sd_mm = config.shift_sd_mm if slide.timed else config.untimed_sd_mm
    own = response.at(slide.depth_mm, slide.height_mm)
    for _ in range(ITERATIONS):
        volts = slide.shown(own, shift_mm)
        h = SHIFT_STEP_MM
        slope = gain * (slide.shown(own, shift_mm + h) - slide.shown(own, shift_mm - h)) / (2 * h)
        jacobian = np.stack([volts.ravel(), slope.ravel()], axis=1) / noise
        jacobian = np.vstack([jacobian, np.diag([1 / config.gain_sd, 1 / shift_sd_mm])])
        residuals = np.append(
            (slide.volts - gain * volts).ravel() / noise,
            [(1 - gain) / config.gain_sd, -shift_mm / shift_sd_mm],
        )
        step = np.linalg.lstsq(jacobian, residuals, rcond=None)[0]
        gain, shift_mm = gain + step[0], shift_mm + step[1]
    return SlideFit(slide, gain, shift_mm, slide.volts - gain * slide.shown(own, shift_mm))


def with_lag(
    conditioning: Conditioning,
    slides: list[CalibrationSlide],
    response: ResponseMap,
    held_out: list[tuple[ResponseMap, np.ndarray]],
) -> Conditioning:
    """The conditioning that undoes, with its own, the lag that a map of its signal still shows.

    held_out: as in `retardation_s`. The same conditioning where nothing is left to undo.
    """
    lag_s = response.lag_s
    if abs(lag_s) < LEAST_LAG_S or lag_s < -conditioning.lag_s:
        return conditioning
    # A plain delay stands for all of a solid's lag only in slow slides; what faster ones still show is added.
    tau_s = conditioning.tau_s if conditioning.delayed else retardation_s(slides, held_out, lag_s)
    delayed = min((conditioning.lag_s + lag_s) / tau_s, MOST_DELAYED)
    return replace(conditioning, delayed=delayed, tau_s=tau_s)


def retardation_s(
    slides: list[CalibrationSlide], held_out: list[tuple[ResponseMap, np.ndarray]], lag_s: float
) -> float:
    """The most probable of TAUS_S (s) given the residuals of maps of other lines; the prior's middle without any.

    held_out: maps with the recordings (names) that each was not fitted to. lag_s: of these maps.
    """
    if not held_out:
        return TAU_S
    unseen = [(s, response) for response, names in held_out for s in slides if s.recording in names]
    projections = np.array(
        [[_lag_projection(s, response, lag_s, tau) for s, response in unseen] for tau in TAUS_S]
    )
    # Chi-square with the solid's lag less that with a plain delay, (T, slides): |r - a|^2 - |r|^2 = |a|^2 - 2 a r.
    gains = projections[..., 0] - 2.0 * projections[..., 1]
    best = int(gains.sum(axis=1).argmin())
    # The residual is no white noise: the slides' own scatter says by how much less it counts (an overdispersion).
    counts = max(1.0, len(unseen) * gains[best].var() / (4.0 * projections[best, :, 0].sum() + 1e-12))
    prior = (np.log(np.array(TAUS_S) / TAU_S) / TAU_SPREAD) ** 2
    return TAUS_S[int((gains.sum(axis=1) / counts + prior).argmin())]


def _lag_projection(
    slide: CalibrationSlide, response: ResponseMap, lag_s: float, tau_s: float
) -> tuple[float, float]:
    """What a solid's lag adds to the signal of a plain delay: its squared size, and its product with the residual.

    Both over the residual's variance, and orthogonal to the slide's own gain and shift.
    """
    response = response.at(slide.depth_mm, slide.height_mm)
    fit = fit_slide(slide, response, CalibrationConfig())

    def signal(own: ResponseMap, shift_mm: float) -> np.ndarray:
        return fit.gain * slide.shown(own, shift_mm)

    plain = signal(response, fit.shift_mm)
    slope = signal(response, fit.shift_mm + LAG_STEP_MM) - signal(response, fit.shift_mm - LAG_STEP_MM)
    still = signal(replace(response, lag_s=response.lag_s - lag_s), fit.shift_mm)
    solid = standard_solid(still, slide.step_s, min(lag_s / tau_s, MOST_DELAYED), tau_s)
    own = np.stack([plain.ravel(), slope.ravel()], axis=1)
    both = np.stack([(solid - plain).ravel(), fit.residual_v.ravel()], axis=1)
    added, residual = (both - own @ np.linalg.lstsq(own, both, rcond=None)[0]).T
    return float(added @ added / residual.var()), float(added @ residual / residual.var())

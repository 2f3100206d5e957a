"""The skin's viscoelastic lag, found from the calibration slides.

How late the skin answers shows in slides of any speed: a map that follows the contact with a plain delay takes care of
it. How the answer is spread over time shows in fast slides alone, as features that grow wider: a standard linear solid
of the same lag, whose retardation time the calibration slides tell as far as they can and a prior tells otherwise. It
is undone in the signal (features/stream/conditioning.py), so that map, network and training need not know of it.
"""

from dataclasses import replace

import numpy as np

from features.stream.conditioning import Conditioning
from models.response_map.config import CalibrationConfig
from models.response_map.map import ResponseMap
from models.response_map.slide_fit import fit_slide
from models.response_map.slides import CalibrationSlide
from pipeline.synthesis.viscoelastic_lag import standard_solid

TAUS_S = (0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
# The prior of the retardation time: middle and standard deviation of its logarithm, what the synthesis draws from.
TAU_S, TAU_SPREAD = 0.15, 0.6
LEAST_LAG_S = 0.004  # a fifth of a block; below this there is nothing to undo
MOST_DELAYED = 0.4  # share of the answer that may creep; the synthesis draws less
SHIFT_STEP_MM = 0.1  # of the difference that tells a slide's shift from its lag


def with_lag(
    conditioning: Conditioning,
    slides: list[CalibrationSlide],
    response: ResponseMap,
    held_out: list[tuple[ResponseMap, np.ndarray]],
) -> Conditioning:
    """The conditioning that undoes, besides its own, the lag that a map of its signal still shows.

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
    response = response.at_height(slide.height_mm)
    fit = fit_slide(slide, response, CalibrationConfig())

    def signal(at: float, lag: float) -> np.ndarray:
        return fit.gain * response.response(*slide.place(at, lag), slide.direction_rad, slide.depth_mm)

    plain = signal(fit.shift_mm, response.lag_s)
    h = SHIFT_STEP_MM
    slope = signal(fit.shift_mm + h, response.lag_s) - signal(fit.shift_mm - h, response.lag_s)
    solid = standard_solid(
        signal(fit.shift_mm, response.lag_s - lag_s), slide.step_s, min(lag_s / tau_s, MOST_DELAYED), tau_s
    )
    own = np.stack([plain.ravel(), slope.ravel()], axis=1)
    both = np.stack([(solid - plain).ravel(), fit.residual_v.ravel()], axis=1)
    added, residual = (both - own @ np.linalg.lstsq(own, both, rcond=None)[0]).T
    return float(added @ added / residual.var()), float(added @ residual / residual.var())

"""A device's map with its skin's lag undone.

How late the skin answers shows in slides of any speed, and a map that follows the contact with a lag takes care of it.
How the answer is spread over time shows in fast slides alone, as features that grow wider: a standard linear solid of
the same lag, whose retardation time the calibration slides tell as far as they can and a prior tells otherwise. It is
undone in the signal (features/stream/conditioning.py), so that the map, the network and its training know nothing
of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from features.stream.conditioning import Conditioning
from models.response_map.calibrate import CalibrationConfig, CalibrationSlide, calibration_slides, fit_slide
from models.response_map.from_atlas import DeviceSpread
from models.response_map.map import ResponseMap
from models.response_map.select import DeviceMaps, device_maps
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder
from pipeline.synthesis.viscoelastic_lag import standard_solid

TAUS_S = (0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6)
# The prior of the retardation time: middle and standard deviation of its logarithm, what the synthesis draws from.
TAU_S, TAU_SPREAD = 0.15, 0.6
LEAST_LAG_S = 0.004  # below this there is nothing to undo
PASSES = 3
MOST_DELAYED = 0.4


@dataclass(frozen=True)
class Device:
    """What was found of one device: how to read its signal, and what it answers; slides: how many told it."""

    conditioning: Conditioning
    maps: DeviceMaps
    slides: int


def calibrated_device(
    folder: Folder,
    atlas: Atlas | None,
    conditioning: Conditioning,
    calibration: CalibrationConfig,
    spread: DeviceSpread,
) -> Device:
    """Calibrates on the folder's slides: the map first, then its lag's shape, then the map of the signal without lag.

    A lag that `conditioning` already names is taken as it is.

    Raises:
        InputError: as `device_maps`.
    """
    given = conditioning.delayed > 0
    slides = calibration_slides(folder, conditioning)
    maps = device_maps(slides, folder.sensor, atlas, calibration, spread)
    for _ in range(PASSES):
        lag_s = maps.response.lag_s
        if given or abs(lag_s) < LEAST_LAG_S or lag_s < -conditioning.lag_s:
            break
        # A plain lag stands for all of a solid's only in slow slides; what faster ones still show is added.
        tau_s = conditioning.tau_s if conditioning.delayed else retardation_s(slides, maps.held_out, lag_s)
        delayed = min((conditioning.lag_s + lag_s) / tau_s, MOST_DELAYED)
        conditioning = replace(conditioning, delayed=delayed, tau_s=tau_s)
        slides = calibration_slides(folder, conditioning)
        maps = device_maps(slides, folder.sensor, atlas, calibration, spread)
    found = {"delayed": conditioning.delayed, "tau_s": conditioning.tau_s}
    return Device(conditioning, replace(maps, summary=maps.summary | found), len(slides))


def retardation_s(
    slides: list[CalibrationSlide], held_out: list[tuple[ResponseMap, np.ndarray]], lag_s: float
) -> float:
    """The most probable of TAUS_S (s), by what maps of other lines leave over; the prior's middle if there are none."""
    if not held_out:
        return TAU_S
    unseen = [(s, response) for response, names in held_out for s in slides if s.recording in names]
    shares = np.array([[_spread_share(s, response, lag_s, tau) for s, response in unseen] for tau in TAUS_S])
    # Chi-square with the solid's lag less that with a plain one, (T, slides).
    gaps = shares[..., 0] - 2.0 * shares[..., 1]
    best = int(gaps.sum(axis=1).argmin())
    # What is left over is no white noise: the slides' own scatter says how much less it counts.
    counts = max(1.0, len(unseen) * gaps[best].var() / (4.0 * shares[best, :, 0].sum() + 1e-12))
    prior = (np.log(np.array(TAUS_S) / TAU_S) / TAU_SPREAD) ** 2
    return TAUS_S[int((gaps.sum(axis=1) / counts + prior).argmin())]


def _spread_share(
    slide: CalibrationSlide, response: ResponseMap, lag_s: float, tau_s: float
) -> tuple[float, float]:
    """What a solid's lag would add to a plain one's signal: its size squared, and its product with what is left over.

    Both over the variance of what is left over, and clear of the slide's own gain and shift.
    """
    gain, shift, left = fit_slide(slide, 1.0, 0.0, response, CalibrationConfig())

    def signal(at: float, lag: float) -> np.ndarray:
        return gain * response.response(*slide.place(at, lag), slide.direction_rad, slide.depth_mm)

    plain = signal(shift, response.lag_s)
    slope = signal(shift + 0.1, response.lag_s) - signal(shift - 0.1, response.lag_s)
    solid = standard_solid(
        signal(shift, response.lag_s - lag_s), slide.step_s, min(lag_s / tau_s, MOST_DELAYED), tau_s
    )
    own = np.stack([plain.ravel(), slope.ravel()], axis=1)
    both = np.stack([(solid - plain).ravel(), left.ravel()], axis=1)
    added, over = (both - own @ np.linalg.lstsq(own, both, rcond=None)[0]).T
    return float(added @ added / over.var()), float(added @ over / over.var())

"""One specimen of a sensor: a physical sensor as made, which differs from its design; drawn from a seed."""

from dataclasses import dataclass

import numpy as np

from softslide.pipeline.sensor import Sensor
from softslide.pipeline.synthesis.distribution import Distribution, log_uniform
from softslide.pipeline.synthesis.electronics import Electronics, draw_electronics

# Of a seed's streams of random numbers, the specimen's.
_STREAM = 0


@dataclass(frozen=True)
class Specimen:
    """What stays the same from slide to slide.

    delayed, tau_s: the skin's lag, see `viscoelastic_lag.standard_solid`. vibration_g, vibration_hz: of rubbing.
    ripple, ripple_hz: the pressure's relative amplitude and frequency. friction_mm: distance over which friction
    reverses. drift_g: standard deviation of an output's drift in a minute.
    """

    electronics: Electronics
    delayed: float = 0.0
    tau_s: float = 0.1
    vibration_g: float = 0.0
    vibration_hz: float = 100.0
    ripple: float = 0.0
    ripple_hz: float = 1.0
    friction_mm: float = 0.3
    drift_g: float = 0.0


def draw_specimen(sensor: Sensor, distribution: Distribution, seed: int) -> Specimen:
    """The seed's specimen."""
    random = np.random.default_rng([seed, _STREAM])
    d = distribution
    return Specimen(
        draw_electronics(sensor, d.electronics, random),
        delayed=float(random.uniform(*d.delayed)),
        tau_s=log_uniform(random, d.tau_s),
        vibration_g=log_uniform(random, d.vibration_g),
        vibration_hz=float(random.uniform(*d.vibration_hz)),
        ripple=log_uniform(random, d.ripple),
        ripple_hz=log_uniform(random, d.ripple_hz),
        friction_mm=d.friction_mm,
        drift_g=d.drift_g,
    )

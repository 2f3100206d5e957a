"""Constants of a map's calibration."""

from dataclasses import dataclass, replace

from models.ranges import POSITIVE, check_ranges


@dataclass(frozen=True)
class CalibrationConfig:
    """Constants of the fit, chosen on held-out calibration lines (experiments/LOG.md).

    smooth_mean, smooth_friction: penalties on second differences, per V^2, for data in units of one block's noise.
    near_prior: penalty on the distance from an atlas's prior, likewise.
    gain_sd, shift_sd_mm: priors on each slide's own gain and place. untimed_sd_mm: on the place of a slide whose
        labels do not tell it, about the first guess of onset.py.
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

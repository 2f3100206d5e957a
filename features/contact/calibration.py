"""What the model card carries for the tracking of contacts: the calibrated response map and its errors."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softslide.features.contact.packed import packed, unpacked
from softslide.features.contact.response_surface import PARTS, ResponseSurface

# Far beyond any skin; they bound the memory.
MOST_KNOTS = 200
LARGEST = 1e6
LEAST_EIGENVALUE = 1e-9  # of a correlation matrix that is inverted in double precision


@dataclass(frozen=True)
class ContactCalibration:
    """The card's section `contact`.

    coefficients: float16, little-endian, `packed`, (4, K, K, C) in units of scale_v: the splines of M, Fx, Fy (V) and D
    (V/mm). knots: K. half_mm: the splines cover [-half_mm, half_mm]. spacing_mm: of the knots.
    chamber_mm: sizes of the chamber. depth_mm: the calibration's. noise_v: (C,) V, of a block's mean. floor_v: V, the
    map's residual where there is no output. floor_share: what is added in quadrature, of the largest output of the
    channels; none: not known, and floor_v is of all outputs. gain_sd: of the gain from slide to slide. depth_sd_mm: of
    the contact depth about the calibration's.
    inflation_v_per_mm: (C,) V/mm, by which the output at rest changes as the skin rises; none: not known.
    static_v: (3 A,) V, the output at rest over the calibration, all three of each accelerometer, at the height that
    the map is of; static_covariance_v2: (3 A, 3 A) V^2, from slide to slide; none: not known.

    Raises:
        ValueError: a number is out of range, or the coefficients are not as many as K and C say.
    """

    coefficients: str
    scale_v: float
    knots: int
    half_mm: float
    spacing_mm: float
    chamber_mm: tuple[float, float]
    depth_mm: float
    noise_v: tuple[float, ...]
    floor_v: float
    gain_sd: float
    depth_sd_mm: float = 0.02
    inflation_v_per_mm: tuple[float, ...] = ()
    static_v: tuple[float, ...] = ()
    static_covariance_v2: tuple[tuple[float, ...], ...] = ()
    floor_share: float | None = None

    def __post_init__(self) -> None:
        numbers = (self.scale_v, self.half_mm, self.spacing_mm, *self.chamber_mm, *self.noise_v, self.floor_v)
        numbers = (*numbers, self.gain_sd, self.depth_mm, self.depth_sd_mm)
        check_map("contact", numbers, self.knots, self.coefficients)
        share = 0.0 if self.floor_share is None else self.floor_share
        if isinstance(share, bool) or not isinstance(share, int | float) or not 0.0 <= share < 1.0:
            raise ValueError(f"contact: floor_share {share!r:.40}: out of range")
        if len(self.chamber_mm) != 2:
            raise ValueError(f"contact: chamber_mm {self.chamber_mm!r:.40}: out of range")
        inflation = self.inflation_v_per_mm
        if inflation and len(inflation) != len(self.noise_v):
            raise ValueError(f"contact: {len(inflation)} inflation_v_per_mm, not {len(self.noise_v)}")
        for value in inflation:
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < LARGEST:
                raise ValueError(f"contact: inflation_v_per_mm {value!r:.40}: out of range")
        self._check_static()
        self.surface()

    def _check_static(self) -> None:
        if not self.static_v and not self.static_covariance_v2:
            return
        channels = len(self.static_v)
        covariance = np.array(self.static_covariance_v2, dtype=float)
        # Of each three outputs all answer to a touch, or x and y.
        like_noise = 3 * len(self.noise_v) in (3 * channels, 2 * channels)
        if covariance.shape != (channels, channels) or channels % 3 or not like_noise:
            raise ValueError(
                f"contact: static_v has {channels} channels, static_covariance_v2 or noise_v others"
            )
        if not (np.abs(np.array(self.static_v, dtype=float)) < LARGEST).all():
            raise ValueError(f"contact: static_v is not finite or beyond {LARGEST:g}")
        variance = covariance.diagonal()
        if not ((variance > 0) & (variance < LARGEST)).all() or not (np.abs(covariance) < LARGEST).all():
            raise ValueError("contact: a number of static_covariance_v2 is out of range")
        correlation = covariance / np.sqrt(np.outer(variance, variance))
        symmetric = np.allclose(correlation, correlation.T)
        if not symmetric or not np.linalg.eigvalsh(correlation)[0] > LEAST_EIGENVALUE:
            raise ValueError("contact: static_covariance_v2 is no covariance, or cannot be inverted")

    @property
    def chamber_half_mm(self) -> tuple[float, float]:
        """Half the chamber's sizes along x and y."""
        return self.chamber_mm[0] / 2, self.chamber_mm[1] / 2

    def surface(self) -> ResponseSurface:
        """The response map, ready to be read."""
        return ResponseSurface(self.splines(), self.half_mm, self.spacing_mm)

    def splines(self) -> np.ndarray:
        """(4, K, K, C): the splines of M, Fx, Fy (V) and D (V/mm)."""
        return decoded(self.coefficients, (PARTS, self.knots, self.knots, len(self.noise_v)), self.scale_v)


def encoded(coefficients: np.ndarray) -> tuple[str, float]:
    """Coefficients in V -> the card's text and its scale. Half precision keeps 1 in 2000 of each, below the noise."""
    scale = float(np.abs(coefficients).max()) or 1.0
    return packed((coefficients / scale).astype("<f2")), scale


def check_map(section: str, numbers: Sequence[float], knots: int, coefficients: str) -> None:
    """Sees that a card's map can be read. section: of the card.

    Raises:
        ValueError: a number is not above 0, there are too few or too many knots, or the coefficients are no text.
    """
    for value in numbers:
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < LARGEST:
            raise ValueError(f"{section}: {value!r:.40} is no number above 0 and below {LARGEST:g}")
    if type(knots) is not int or not 4 <= knots <= MOST_KNOTS:
        raise ValueError(f"{section}: knots {knots!r:.40}: out of range")
    if not isinstance(coefficients, str):
        raise ValueError(f"{section}: coefficients are no text")


def decoded(text: str, shape: tuple[int, ...], scale: float) -> np.ndarray:
    """Coefficients of the shape from a card's text and its scale.

    Raises:
        ValueError: they are not as many, or one is not finite.
    """
    values = unpacked(text, "<f2", shape).astype(float) * scale
    if not np.isfinite(values).all():
        raise ValueError("a coefficient of a map is not finite")
    return values

"""The response map: a sensor's output for a contact at x, y, moving in a direction, at a depth.

V(x, y, a, d) = g [M(x, y) + cos(a) Fx(x, y) + sin(a) Fy(x, y) + (d - d0) D(x, y)], g = 1 + slide-to-slide error

Of a skin that is inflated to several heights M is that of the height h0, and M + (h - h0) H that of h.

M is the response without friction, Fx and Fy what friction adds along each axis (first order in the friction
coefficient), D the change with contact depth; each a tensor product of uniform cubic B-splines (de Boor 1978). The
signal follows the contact with a lag. Of accelerometers only V_x and V_y are mapped: gravity has a fixed length, so V_z
adds nothing to them. Sensing elements of other kinds may have three mapped axes.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

SPACING_MM = 2.5  # of the splines, unless a map says otherwise; recorded lines are 5 mm apart
MARGIN_MM = 5.0  # the map reaches this far over the chamber's rim, two splines on which it falls to zero
GRID_MM = 1.0  # of the points that splines are fitted to
PARTS = 3  # mean, along x, along y


@dataclass(frozen=True)
class ResponseMap:
    """A sensor's response, calibrated or not.

    coefficients: (3, K, K, C) V, spline coefficients of M, Fx, Fy; C channels that answer to a touch, a0_vx, a0_vy,
        a1_vx, ...; `axes` of each sensing element.
    depth_slope: (K, K, C) V/mm, spline coefficients of D; zero without an atlas.
    chamber_mm: sizes of the chamber along x and y.
    rim: whether the skin lies on the base over the chamber's rim and shows nothing. Without a rim nothing is known of
        what lies beyond the chamber, and contacts come down and are lifted anywhere on it.
    spacing_mm: of the splines.
    whitening: (C, C), what makes the map's residuals in its channels independent of each other and alike; None: they
        are.
    reference_mm: the point that offsets are measured from.
    depth_mm: d0, the middle of the contact depths of the recordings that the map was fitted to.
    height_mm: h0, the skin's height of most of these recordings. height_slope: (K, K, C) V/mm, spline coefficients of
        H; None: the recordings have one height. height_range_mm: the lowest and the highest of them.
    depth_sd_mm: standard deviation about d0 of the depths that are to be expected, where the recordings have several;
        0: they have one.
    lag_s: the skin's lag behind the contact.
    noise_v: (C,) V, standard deviation of one block's mean at rest. Empty: not known; zero_v and drift_v_s likewise.
    zero_v: (C,) V, standard deviation of the zero's error at a slide's start. drift_v_s: (C,) V/s, of its drift.
    floor_v: V, standard deviation of the map's residual. weak_floor_v, floor_share: where there is no output, and what
        is added in quadrature as a share of the largest output of the channels; None: not known.
    level_v, output_share, place_mm: the residual's parts along a slide, which add in quadrature: one that is alike
        everywhere, one in proportion to the slide's largest output, and one in proportion to how fast the output
        changes along the way, as where the map is off in place.
    gain_sd: standard deviation of the slide-to-slide gain.
    """

    coefficients: np.ndarray
    depth_slope: np.ndarray
    chamber_mm: tuple[float, float]
    reference_mm: tuple[float, float]
    depth_mm: float = 0.5
    depth_sd_mm: float = 0.0
    lag_s: float = 0.0
    noise_v: np.ndarray = field(default_factory=lambda: np.zeros(0))
    zero_v: np.ndarray = field(default_factory=lambda: np.zeros(0))
    drift_v_s: np.ndarray = field(default_factory=lambda: np.zeros(0))
    floor_v: float = 1e-3
    weak_floor_v: float | None = None
    floor_share: float | None = None
    level_v: float = 6e-4
    output_share: float = 0.003
    place_mm: float = 0.0
    gain_sd: float = 0.02
    axes: int = 2
    rim: bool = True
    spacing_mm: float = SPACING_MM
    whitening: np.ndarray | None = None
    height_mm: float = math.nan
    height_slope: np.ndarray | None = None
    height_range_mm: tuple[float, float] = (math.nan, math.nan)

    @property
    def half_mm(self) -> float:
        """The splines cover [-half_mm, half_mm] in x and y: the chamber and a margin of its rim."""
        return half_of(self.chamber_mm)

    @property
    def channels(self) -> int:
        """Number C of channels that answer to a touch."""
        return int(self.coefficients.shape[-1])

    @property
    def boards(self) -> int:
        """Number of sensing elements."""
        return self.channels // self.axes

    def response(self, x_mm: np.ndarray, y_mm: np.ndarray, direction_rad: float | np.ndarray) -> np.ndarray:
        """Subtracted output (n, C) V for contacts at (n,) positions moving in one direction or in (n,)."""
        a = np.broadcast_to(np.asarray(direction_rad, dtype=float), np.shape(x_mm))[:, None]
        weights = np.stack([np.ones_like(a), np.cos(a), np.sin(a)])
        (i, across), (j, up) = (splines_at(place, self.half_mm, self.spacing_mm) for place in (x_mm, y_mm))
        patch = self.coefficients.transpose(1, 2, 0, 3)[i[:, :, None], j[:, None, :]]
        each = across[:, :, None, None] * up[:, None, :, None] * weights.transpose(1, 2, 0)[:, :, None]
        return (each.reshape(len(i), 1, -1) @ patch.reshape(len(i), -1, self.channels))[:, 0]

    def at(self, depth_mm: float = math.nan, height_mm: float = math.nan) -> "ResponseMap":
        """The map at a contact depth and of one height of the skin; its own where NaN, or where it has one height."""
        still, response = self.coefficients[0], self
        if not math.isnan(depth_mm):
            still = still + (depth_mm - self.depth_mm) * self.depth_slope
            response = replace(response, depth_mm=depth_mm)
        if self.height_slope is not None and not math.isnan(height_mm):
            still = still + (height_mm - self.height_mm) * self.height_slope
            response = replace(response, height_mm=height_mm, height_slope=None)
        return replace(response, coefficients=np.concatenate([still[None], self.coefficients[1:]]))

    def scaled(self, gain: float | np.ndarray) -> "ResponseMap":
        """The same map with every response times `gain`, one for all channels or (C,)."""
        return replace(
            self,
            coefficients=self.coefficients * gain,
            depth_slope=self.depth_slope * gain,
            height_slope=None if self.height_slope is None else self.height_slope * gain,
        )


def half_of(chamber_mm: tuple[float, float]) -> float:
    """How far a chamber's splines reach from its centre, mm."""
    return max(chamber_mm) / 2 + MARGIN_MM


def knots(half_mm: float, spacing_mm: float = SPACING_MM) -> int:
    """Number K of B-splines that cover [-half_mm, half_mm]."""
    return round(2 * half_mm / spacing_mm) + 3


def splines_at(
    position_mm: np.ndarray, half_mm: float, spacing_mm: float = SPACING_MM
) -> tuple[np.ndarray, np.ndarray]:
    """The four uniform cubic B-splines around (n,) positions -> their numbers (n, 4) and values (n, 4).

    B(z) = (2 - |z|)+^3 / 6 - 4 (1 - |z|)+^3 / 6, z the distance to a spline's centre over the spacing; zero where
    there is no such spline.
    """
    u = (np.asarray(position_mm, dtype=float)[:, None] + half_mm) / spacing_mm
    number = np.floor(u).astype(int) + np.arange(4)
    z = np.abs(u - (number - 1))
    value = (np.maximum(2 - z, 0) ** 3 - 4 * np.maximum(1 - z, 0) ** 3) / 6
    inside = np.clip(number, 0, knots(half_mm, spacing_mm) - 1)
    return inside, np.where(number == inside, value, 0.0)


def tensor_splines(
    x_mm: np.ndarray, y_mm: np.ndarray, half_mm: float, spacing_mm: float = SPACING_MM
) -> sparse.csr_matrix:
    """Values of the tensor-product splines at points (n,): rows (n, K^2), 16 entries each."""
    (i, across), (j, up) = (splines_at(place, half_mm, spacing_mm) for place in (x_mm, y_mm))
    k = knots(half_mm, spacing_mm)
    columns, values = k * i[:, :, None] + j[:, None, :], across[:, :, None] * up[:, None, :]
    begins = 16 * np.arange(len(i) + 1)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), begins), shape=(len(i), k * k))


def spline_basis(position_mm: np.ndarray, half_mm: float) -> np.ndarray:
    """Every spline at (n,) positions -> (n, K)."""
    number, value = splines_at(position_mm, half_mm)
    basis = np.zeros((len(number), knots(half_mm)))
    np.add.at(basis, (np.arange(len(number))[:, None], number), value)
    return basis


def grid_axis(half_mm: float) -> np.ndarray:
    """(n,) mm: places GRID_MM apart that cover the splines' range."""
    return np.arange(-half_mm, half_mm + GRID_MM / 2, GRID_MM)


def spline_grid(half_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """x and y (n^2,) of the points of a square grid over the splines' range."""
    x, y = np.meshgrid(grid_axis(half_mm), grid_axis(half_mm), indexing="ij")
    return x.ravel(), y.ravel()


def spline_coefficients(values: np.ndarray, half_mm: float) -> np.ndarray:
    """Least-squares coefficients (K, K, C) of values (n^2, C) at the points of `spline_grid`."""
    axis = grid_axis(half_mm)
    inverse = np.linalg.pinv(spline_basis(axis, half_mm), rcond=1e-6)
    square = values.reshape(len(axis), len(axis), -1)
    return np.einsum("in,nmc,jm->ijc", inverse, square, inverse, optimize=True)

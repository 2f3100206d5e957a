"""The response atlas: what each board reads and the indenter feels, over its place, heading, depth and
pressure.

At every grid point a mean over headings and two friction parts are kept,

    value(heading) = mean + cos(heading) fx + sin(heading) fy

which is exact in the four headings along the axes when friction acts to first order. All parts are
interpolated by tensor splines, cubic where there are four levels, the pressure's through its cube root, as
which a membrane rises. A pressure level is the model's *effective* pressure in MPa, found from the skin's
height; it is not the regulator's figure (see `pipeline.sensor.Skin`).
"""

import hashlib
import json
import zipfile
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import NdBSpline
from scipy.optimize import brentq

from softslide.features.errors import InputError
from softslide.features.regular_file import check_regular
from softslide.pipeline.atlas.splines import along, check_inside, fit_axis
from softslide.pipeline.sensor import Sensor, design_hash, design_of
from softslide.pipeline.skin.lines import PER_BOARD
from softslide.pipeline.staging import whole, writing

VERSION = 1
DEFAULT_ATLAS = Path(__file__).parent / "default_atlas.npz"
DEFAULT_SENSOR = Path(__file__).parent / "default_sensor.toml"
# The finest atlas of ten accelerometers has some 100 MB.
MOST_BYTES, MOST_UNPACKED_BYTES = 1 << 29, 1 << 31
# In any of an atlas's units.
LARGEST = 1e6
# A height asked for is solved to within 1 um (pipeline/skin/solver.py).
_HEIGHT_MARGIN_MM = 1.1e-3
_ARRAYS = ("x_mm", "y_mm", "depth_mm", "pressure_mpa", "height_mm", "statics", "parts", "valid")
Values = np.ndarray | float  # (n,), or one for all


@dataclass(frozen=True, eq=False)
class Atlas:
    """A solved design. `parts` holds, at each grid point, mean, fx and fy of each channel."""

    x_mm: np.ndarray  # (nx,) evenly spaced, from the chamber's centre
    y_mm: np.ndarray  # (ny,)
    depth_mm: np.ndarray  # (nd,) the indenter's lowest point below the flat skin's face
    pressure_mpa: np.ndarray  # (np,) effective
    height_mm: np.ndarray  # (np,) the inflated, untouched skin's highest point over the flat one
    statics: np.ndarray  # (np, boards, 3) g: what each accelerometer reads untouched
    parts: np.ndarray  # (3, nx, ny, nd, np, 7 boards + 3), channels as `pipeline.skin.lines.PER_BOARD` says
    valid: np.ndarray  # (nx, ny, nd, np) bool: false next to a position that did not converge
    meta: dict[str, Any]  # design, its hash, mesh, tolerances, statistics, failed positions

    @property
    def boards(self) -> int:
        """Number of accelerometers."""
        return self.statics.shape[1]

    @property
    def failed(self) -> list[list[float]]:
        """[x_mm, y_mm, heading_deg, depth_mm, height_mm] of each position that did not converge."""
        return self.meta["failed"]

    def response(
        self, x_mm: Values, y_mm: Values, heading_deg: Values | None, depth_mm: Values, pressure_level: Values
    ) -> np.ndarray:
        """The subtracted gravity vector in each board's frame, contact minus static.

        Args:
            x_mm, y_mm: (n,) the indenter's centre. heading_deg: (n,) or one, as `direction_deg` of a
                manifest; None for an indentation without sliding, which is the mean over headings.
            depth_mm: (n,) or one. pressure_level: (n,) or one, effective MPa.

        Returns:
            (n, boards, 3) g; times `sensitivity_v_per_g` it is the subtracted voltage. Zero where the
            indenter cannot touch the inflated skin, nan next to a position that was not solved.

        Raises:
            InputError: a depth or a pressure lies outside the atlas.
        """
        own = slice(0, PER_BOARD * self.boards)
        values = _towards(heading_deg, self.friction_parts(x_mm, y_mm, depth_mm, pressure_level, own))
        return values.reshape(len(values), self.boards, PER_BOARD)[..., :3]

    def force(
        self, x_mm: Values, y_mm: Values, heading_deg: Values | None, depth_mm: Values, pressure_level: Values
    ) -> np.ndarray:
        """The skin's force on the indenter (n, 3) N: along x and y, and normal (positive = out)."""
        forces = slice(PER_BOARD * self.boards, None)
        return _towards(heading_deg, self.friction_parts(x_mm, y_mm, depth_mm, pressure_level, forces))

    def static(self, pressure_level: float) -> np.ndarray:
        """(boards, 3) g: what the accelerometers read when nothing touches the skin."""
        return along(np.cbrt(self.pressure_mpa), self.statics, self._level(pressure_level))

    def height(self, pressure_level: float) -> float:
        """The inflated skin's height in mm."""
        return float(along(np.cbrt(self.pressure_mpa), self.height_mm, self._level(pressure_level)))

    def pressure_at(self, height_mm: float) -> float:
        """The effective pressure, MPa, of a skin height.

        Raises:
            InputError: the height lies outside the atlas.
        """
        low, high = self.height_mm[[0, -1]]
        if not low - _HEIGHT_MARGIN_MM <= height_mm <= high + _HEIGHT_MARGIN_MM:
            raise InputError(
                f"a skin height of {height_mm:g} mm is outside the atlas's {low:.3g}..{high:.3g} mm"
            )
        ends = (float(self.pressure_mpa[0]), float(self.pressure_mpa[-1]))
        if not low < height_mm < high:
            return ends[int(height_mm >= high)]
        return brentq(lambda pressure: self.height(pressure) - height_mm, *ends, xtol=1e-10)

    def _level(self, pressure: float) -> float:
        check_inside("pressure_level", np.asarray(pressure), self.pressure_mpa, "MPa")
        return float(np.cbrt(pressure))

    def friction_parts(
        self,
        x_mm: Values,
        y_mm: Values,
        depth_mm: Values,
        pressure_level: Values,
        wanted: slice = slice(None),
    ) -> np.ndarray:
        """Mean, fx and fy (n, 3, channels) of the wanted channels, ordered as in `parts`.

        Zero where the indenter cannot touch, nan next to a position that was not solved.

        Raises:
            InputError: a depth or a pressure lies outside the atlas.
        """
        x, y = (np.atleast_1d(np.asarray(v, float)) for v in (x_mm, y_mm))
        depth, level = (np.atleast_1d(np.asarray(v, float)) for v in (depth_mm, pressure_level))
        check_inside("depth_mm", depth, self.depth_mm, "mm")
        check_inside("pressure_level", level, self.pressure_mpa, "MPa")
        reach = self.meta["reach_mm"]
        out = (np.abs(x) > reach[0]) | (np.abs(y) > reach[1])
        x, y, out = np.broadcast_arrays(np.where(out, 0.0, x), np.where(out, 0.0, y), out)
        # To make the plane costs as much as some hundred queries of the volume.
        if len(x) > 400 and np.ptp(depth) == 0 and np.ptp(level) == 0:
            spline = _plane(self, float(depth[0]), float(level[0]), wanted.start, wanted.stop)
            parts = np.asarray(spline(np.column_stack([x, y])))
        else:
            depth, level = np.broadcast_to(depth, x.shape), np.broadcast_to(level, x.shape)
            spline = _volume(self, wanted.start, wanted.stop)
            parts = np.asarray(spline(np.column_stack([x, y, depth, np.cbrt(level)])))
        parts[out] = 0.0
        if not self.valid.all():
            cells = np.broadcast_arrays(x, y, depth, level)
            parts[self._near_failure(*cells) & ~out] = np.nan
        return parts

    @cached_property
    def _coefficients(self) -> tuple[tuple[np.ndarray, ...], np.ndarray, tuple[int, ...]]:
        """Knots, coefficients (nx, ny, nd, np, 3, channels) and degrees of the tensor spline."""
        coefficients = np.moveaxis(self.parts, 0, -2).astype(float)
        knots, degrees = [], []
        for axis, grid in enumerate((self.x_mm, self.y_mm, self.depth_mm, np.cbrt(self.pressure_mpa))):
            knot, coefficients, degree = fit_axis(grid, coefficients, axis)
            knots.append(knot)
            degrees.append(degree)
        return tuple(knots), coefficients, tuple(degrees)

    def _near_failure(self, *place: np.ndarray) -> np.ndarray:
        """(n,) whether a corner of the grid cell round each query is not valid."""
        bad = np.zeros(len(place[0]), bool)
        ranges = []
        for grid, value in zip((self.x_mm, self.y_mm, self.depth_mm, self.pressure_mpa), place, strict=True):
            low = np.clip(np.searchsorted(grid, value, side="right") - 1, 0, max(len(grid) - 2, 0))
            ranges.append((low, np.minimum(low + 1, len(grid) - 1)))
        for corner in np.ndindex(2, 2, 2, 2):
            bad |= ~self.valid[tuple(r[c] for r, c in zip(ranges, corner, strict=True))]
        return bad


@lru_cache(maxsize=8)
def _plane(atlas: Atlas, depth: float, level: float, start: int, stop: int | None) -> NdBSpline:
    """The spline over x and y alone at one depth and pressure."""
    knots, coefficients, degrees = atlas._coefficients
    values = coefficients[..., start:stop]
    for axis, at in ((3, np.cbrt(level)), (2, depth)):
        line = NdBSpline((knots[axis],), np.moveaxis(values, axis, 0), (degrees[axis],))
        values = np.asarray(line(np.array([[at]])))[0]
    return NdBSpline(knots[:2], np.ascontiguousarray(values), degrees[:2])


@lru_cache(maxsize=4)
def _volume(atlas: Atlas, start: int, stop: int | None) -> NdBSpline:
    """The spline over all four."""
    knots, coefficients, degrees = atlas._coefficients
    return NdBSpline(knots, np.ascontiguousarray(coefficients[..., start:stop]), degrees)


def _towards(heading_deg: Values | None, parts: np.ndarray) -> np.ndarray:
    """(n, channels) of friction's parts (n, 3, channels): the mean, and what motion along the heading adds."""
    if heading_deg is None:
        return parts[:, 0]
    heading = np.broadcast_to(np.deg2rad(heading_deg), len(parts))[:, None]
    return parts[:, 0] + np.cos(heading) * parts[:, 1] + np.sin(heading) * parts[:, 2]


def check_atlas(atlas: Atlas, sensor: Sensor, source: str = "atlas") -> None:
    """Refuses an atlas that was solved for another design.

    Raises:
        InputError: the first part of the design that differs.
    """
    if atlas.meta["design_hash"] == design_hash(sensor):
        return
    theirs, mine = atlas.meta["design"], json.loads(json.dumps(design_of(sensor)))
    for name in [*mine, *(name for name in theirs if name not in mine)]:
        if theirs.get(name) != mine.get(name):
            raise InputError(
                f"{source}: solved for another design ({name} is {theirs.get(name, 'not given')}, the sensor's "
                f"{mine.get(name, 'not given')}); run softslide simulate for this sensor"
            )
    raise InputError(f"{source}: its design's hash is wrong; run softslide simulate again")


def atlas_hash(atlas: Atlas) -> str:
    """SHA-256 of an atlas's design and arrays; not of what solving it cost."""
    digest = hashlib.sha256(json.dumps(atlas.meta["design"], sort_keys=True).encode())
    for name in _ARRAYS:
        digest.update(getattr(atlas, name).tobytes())
    return digest.hexdigest()


def write_atlas(atlas: Atlas, path: Path) -> None:
    """Writes one compressed .npz without pickles; whole or not at all."""
    arrays = {name: getattr(atlas, name) for name in _ARRAYS}
    meta = np.array(json.dumps({"version": VERSION, **atlas.meta}))
    with writing(path, "name another file"):
        path.parent.mkdir(parents=True, exist_ok=True)
        # An open file, so that NumPy adds no suffix.
        with whole(path) as scratch, scratch.open("wb") as file:
            np.savez_compressed(file, meta=meta, **arrays)


def read_atlas(path: Path = DEFAULT_ATLAS) -> Atlas:
    """Reads an atlas, by default the one of the article's sensor that ships with the project.

    Raises:
        InputError: there is no such file, it is not an atlas, or one of another version.
    """
    check_regular(path, MOST_BYTES, "name an atlas that softslide simulate wrote")
    try:
        with zipfile.ZipFile(path) as packed:
            if (size := sum(item.file_size for item in packed.infolist())) > MOST_UNPACKED_BYTES:
                raise ValueError(f"{size / 1e6:.3g} MB unpacked, more than any atlas")
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            version = meta.pop("version")
            if version != VERSION:
                raise InputError(
                    f"{path}: an atlas of version {version!r:.20}, not {VERSION}; run softslide simulate again"
                )
            atlas = Atlas(**{name: file[name] for name in _ARRAYS}, meta=meta)
        _check_arrays(atlas)
    except InputError:
        raise
    # A damaged zip raises whatever its parts, their compression or their headers make of it.
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path}: not an atlas or damaged ({reason}); run softslide simulate again"
        ) from None
    return atlas


def _check_arrays(atlas: Atlas) -> None:
    """Raises ValueError where arrays or meta do not fit each other, or hold what no solve gives."""
    grids = (atlas.x_mm, atlas.y_mm, atlas.depth_mm, atlas.pressure_mpa)
    numbers = (*grids, atlas.height_mm, atlas.statics, atlas.parts)
    if any(array.dtype.kind != "f" for array in numbers) or atlas.valid.dtype != bool:
        raise ValueError("an array holds something else than numbers")
    shape = tuple(len(grid) for grid in grids)
    if any(grid.ndim != 1 for grid in (*grids, atlas.height_mm)) or atlas.statics.ndim != 3:
        raise ValueError("its arrays do not fit each other")
    shapes = (shape[3:], (shape[3], atlas.boards, 3), (3, *shape, PER_BOARD * atlas.boards + 3), shape)
    if shapes != (atlas.height_mm.shape, atlas.statics.shape, atlas.parts.shape, atlas.valid.shape):
        raise ValueError("its arrays do not fit each other")
    if not all((np.abs(array) < LARGEST).all() for array in (*grids, atlas.height_mm, atlas.statics)):
        raise ValueError("a number is not finite, or too large")
    if not (np.abs(atlas.parts[:, atlas.valid]) < LARGEST).all():
        raise ValueError("a response is not finite, or too large")
    if any((np.diff(grid) <= 0).any() for grid in (*grids, atlas.height_mm)) or atlas.pressure_mpa[0] <= 0:
        raise ValueError("a grid does not rise")
    meta = atlas.meta
    if not isinstance(meta["design"], dict) or not isinstance(meta["design_hash"], str):
        raise ValueError("its design is not a table")
    if not isinstance(meta["failed"], list) or np.shape(meta["reach_mm"]) != (2,):
        raise ValueError("failed or reach_mm is not a list")
    if not all(0 < float(reach) < LARGEST for reach in meta["reach_mm"]):
        raise ValueError("reach_mm is not positive")

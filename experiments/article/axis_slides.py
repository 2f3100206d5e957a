"""A folder's slides along x and y, as the article has them: what one accelerometer shows of each, and when.

Everything is seen from the first accelerometer: its place takes the reference point's, so that distances are the
article's. Windows and their features are those that a device computes, counted from its trigger.
"""

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.scoring import AXIS_TOLERANCE_DEG
from softslide.features.angles import wrapped_deg
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.features.vector.feature_vector import feature_matrix
from softslide.models.classical.interpolation import DIRECTIONS_DEG, abscissas
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import SAME_DEPTH_MM, learned_depths_mm
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.recordings.windows import labelled_windows

EXTREMES = {"low": "minimum", "high": "maximum"}
# Share of the motion up to which a slide surely moves: after its end the window stands still.
_UNDER_WAY = 0.75


@dataclass(frozen=True)
class AxisSlides:
    """n windows: `windows` of every tenth of the stroke of every slide. Rows of all arrays belong together.

    features: (n, F), of the first accelerometer alone. table: a row a window; `recording`, `split`, `fraction`, `kind`
    (index into AXES), `speed_mm_s`, `offset_mm`, `distance_mm` (from the accelerometer), `elapsed_s` (since the
    trigger), `edge_mm` (where along the line the inflated area begins, from the accelerometer's foot), `along_mm`,
    `trigger_mm` (where the slide triggers, past that edge; of the whole slide), `place_mm` (signed, from the
    accelerometer, across the line), and for each of EXTREMES of the output along the motion its value `low_v` and its
    moment, `low_s` after the trigger and `low_mm` past the chamber's edge; NaN where it has not passed.
    """

    folder: Folder
    conditioning: Conditioning
    features: np.ndarray
    table: pd.DataFrame

    def __getitem__(self, rows: np.ndarray) -> "AxisSlides":
        """The windows that a mask (n,) picks."""
        return replace(self, features=self.features[rows], table=self.table[rows].reset_index(drop=True))

    def __len__(self) -> int:
        return len(self.table)

    @property
    def whole(self) -> "AxisSlides":
        """The windows at the end of the stroke: one a slide."""
        return self[(self.table["fraction"] == 1.0).to_numpy()]


def extremes_of(features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of features (n, F) the extremes of the output along each direction, (n, 4, 2) each: their values, V, their
    moments, s since the trigger, and whether they have passed."""
    values, passed = abscissas(features, "distance")
    return values, abscissas(features, "speed", "quadratic")[0], passed


_NEEDED = (
    *("direction_deg", "speed_mm_s", "offset_mm", "start_x_mm", "start_y_mm", "travel_mm"),
    *("motion_start_s", "motion_end_s"),
)


def read_axis_slides(folder: Folder) -> tuple[AxisSlides | None, list[str]]:
    """The folder's slides along x and y at the calibration's contact depth, None without any; and, a line each,
    how many recordings are left out and why.

    Raises:
        InputError: the sensing elements are not accelerometers, or a slide cannot be read.
    """
    if not folder.sensor.measures_gravity:
        raise InputError(
            f"{folder.root / 'sensor.toml'}: the sensing elements are no accelerometers; the article's figures are of "
            "accelerometers alone"
        )
    folder = seen_from_board(folder)
    manifest = folder.manifest
    known = manifest[list(_NEEDED)].notna().all(axis=1)
    axis = known & (_turned(manifest["direction_deg"].to_numpy(float)).min(axis=1) < AXIS_TOLERANCE_DEG)
    depths = learned_depths_mm(manifest)
    off = np.abs(manifest["depth_mm"].to_numpy(float)[:, None] - np.array(depths or (np.nan,))).min(axis=1)
    same = axis & ~(off > SAME_DEPTH_MM)
    some = replace(folder, manifest=manifest[same])
    slides = _windows(some, conditioning_for(folder, Conditioning())) if same.any() else None
    seen = 0 if slides is None else slides.table["recording"].nunique()
    left_out = {
        "without direction, speed, offset, start and moments of motion": (~known).sum(),
        "along neither x nor y, which the article does not treat": (known & ~axis).sum(),
        "of another contact depth than the calibration's": (axis & ~same).sum(),
        "too weak to be noticed": same.sum() - seen,
    }
    return slides, [f"{count} recordings {why}" for why, count in left_out.items() if count]


def seen_from_board(folder: Folder) -> Folder:
    """The folder with its first accelerometer as the reference point."""
    board = folder.sensor.accelerometers[0]
    angle = np.deg2rad(folder.manifest["direction_deg"].astype(float))
    dx, dy = (r - b for r, b in zip(folder.sensor.reference_mm, (board.x_mm, board.y_mm), strict=True))
    offset = folder.manifest["offset_mm"] + signed_offset(angle, dx, dy)
    sensor = replace(folder.sensor, reference_mm=(board.x_mm, board.y_mm))
    return replace(folder, sensor=sensor, manifest=folder.manifest.assign(offset_mm=offset))


def edges_mm(kind: np.ndarray, chamber_mm: tuple[float, float], board_mm: tuple[float, float]) -> np.ndarray:
    """Where along lines of these kinds (n,) the inflated area begins, mm from the accelerometer's foot."""
    (width, length), (x, y) = chamber_mm, board_mm
    return np.array([-width / 2 - x, -length / 2 - y, -width / 2 + x, -length / 2 + y])[kind]


def _turned(direction_deg: np.ndarray) -> np.ndarray:
    """(n, 4) deg: how far directions (n,) are from DIRECTIONS_DEG; 180 without one."""
    return np.nan_to_num(np.abs(wrapped_deg(direction_deg[:, None] - DIRECTIONS_DEG)), nan=180.0)


def _windows(folder: Folder, conditioning: Conditioning) -> AxisSlides | None:
    try:
        windows = labelled_windows(folder, conditioning)
    except InputError as error:
        if "no slide tilts" in str(error):
            return None
        raise
    kind = _turned(windows.direction_deg).argmin(axis=1)
    columns = ("recording", "split", "speed_mm_s", "offset_mm", "elapsed_s", "along_mm")
    table = pd.DataFrame({name: getattr(windows, name) for name in columns}).assign(
        fraction=windows.stroke_fraction,
        kind=kind,
        distance_mm=np.abs(windows.offset_mm),
        edge_mm=edges_mm(kind, folder.sensor.chamber_mm, folder.sensor.reference_mm),
    )
    trigger = table["along_mm"] - table["edge_mm"] - table["speed_mm_s"] * table["elapsed_s"]
    moving = trigger.where(table["fraction"] < _UNDER_WAY)
    table["trigger_mm"] = moving.groupby(table["recording"]).transform("median")
    # To the left of +x lies +y, to the left of +y lies -x.
    table["place_mm"] = np.array([1.0, -1.0, -1.0, 1.0])[kind] * table["offset_mm"]
    features = feature_matrix(windows.volts[:, :3], windows.elapsed_s).astype(np.float32).astype(np.float64)
    values, moments, passed = (of_all[np.arange(len(kind)), kind] for of_all in extremes_of(features))
    for e, name in enumerate(EXTREMES):
        table[f"{name}_v"] = np.where(passed[:, e], values[:, e], np.nan)
        table[f"{name}_s"] = np.where(passed[:, e], moments[:, e], np.nan)
        table[f"{name}_mm"] = table["trigger_mm"] + table["speed_mm_s"] * table[f"{name}_s"]
    return AxisSlides(folder, conditioning, features, table)

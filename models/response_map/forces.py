"""The force map of a sensor: its solved design at the skin's height, times what a scale read."""

import math
from dataclasses import replace

import numpy as np

from features.contact.force_map import ForceMap, in_steps
from features.force import STEP_MM, ForceReader
from models.response_map.from_atlas import DEPTH_STEP_MM, GRID_MM
from models.response_map.map import MARGIN_MM, SPACING_MM, spline_coefficients
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder
from pipeline.recordings.heights import laser_readings_mm
from pipeline.skin.lines import PER_BOARD

SCALE = "force_mn"  # column of the manifest: the largest normal force of the stroke that a scale read
# Without a scale the force is as uncertain as the modulus, which it is proportional to at a given height: the article
# has 0.07 MPa, the data sheet of Ecoflex 00-10 8 psi = 0.055 MPa at 100 % (a factor of 1.27).
MODULUS_SD = 0.24
# And as the height: fitted to slides and not read; the force grows by a quarter a mm (experiments/LOG.md).
HEIGHT_SD_MM = 0.5
FORCE_PER_MM = 0.25
# Of one reading beside the map: what the map's shape is off along a stroke (another mesh, experiments/LOG.md).
READING_SD = 0.05


def force_map(
    atlas: Atlas, chamber_mm: tuple[float, float], height_mm: float, depth_mm: float, friction: float = 1.0
) -> ForceMap:
    """The map that the atlas gives for a skin height and a contact depth, both brought into the atlas.

    friction: over the design's.
    """
    height_mm = float(np.clip(height_mm, atlas.height_mm[0], atlas.height_mm[-1]))
    depth_mm = float(np.clip(depth_mm, atlas.depth_mm[0], atlas.depth_mm[-1]))
    level, half = atlas.pressure_at(height_mm), max(chamber_mm) / 2 + MARGIN_MM
    grid = np.arange(-half, half + GRID_MM / 2, GRID_MM)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
    forces = slice(PER_BOARD * atlas.boards, None)

    def parts_mn(depth: float) -> np.ndarray:
        return 1e3 * np.nan_to_num(atlas.friction_parts(x, y, depth, level, forces))

    low, high = np.clip(
        [depth_mm - DEPTH_STEP_MM, depth_mm + DEPTH_STEP_MM], atlas.depth_mm[0], atlas.depth_mm[-1]
    )
    parts = parts_mn(depth_mm)
    slope = (parts_mn(high) - parts_mn(low))[:, 0] / (high - low) if high > low else 0 * parts[:, 0]
    surfaces = (parts[:, 0], friction * parts[:, 1], friction * parts[:, 2], slope)
    splines = np.stack(
        [spline_coefficients(v.reshape(len(grid), len(grid), -1), grid, half) for v in surfaces]
    )
    text, steps_mn = in_steps(splines)
    return ForceMap(
        coefficients=text,
        steps_mn=steps_mn,
        knots=splines.shape[1],
        half_mm=half,
        spacing_mm=SPACING_MM,
        depth_mm=depth_mm,
        relative_sd=math.hypot(MODULUS_SD, FORCE_PER_MM * HEIGHT_SD_MM),
    )


def calibrated_forces(folder: Folder, atlas: Atlas, fitted: dict[str, float], depth_mm: float) -> ForceMap:
    """The force map of a folder's sensor.

    The skin's height is a laser's reading (`skin_height_mm` of the manifest) where there is one, else what the slides
    fit (`height_mm` of `fitted`; `friction` as well). A scale's readings (`force_mn`) of slides with all labels give a
    factor: the mean of their logarithms over the map's, with a prior of no factor.
    """
    table = folder.manifest
    read = laser_readings_mm(folder).mean()
    height_mm = fitted["height_mm"] if math.isnan(read) else float(read)
    forces = force_map(atlas, folder.sensor.chamber_mm, height_mm, depth_mm, fitted.get("friction", 1.0))
    reader, ratios = ForceReader(forces), []
    for row in table.to_dict("records") if SCALE in table else ():
        read_mn, angle = float(row[SCALE]), math.radians(row["direction_deg"])
        way = np.arange(0.0, max(np.nan_to_num(row["travel_mm"]), STEP_MM), STEP_MM)
        x, y = row["start_x_mm"] + way * math.cos(angle), row["start_y_mm"] + way * math.sin(angle)
        if not (read_mn > 0 and np.isfinite(x + y).all()):
            continue
        depth = depth_mm if math.isnan(row["depth_mm"]) else row["depth_mm"]
        largest = reader.at(x, y, np.full(len(x), angle), depth)[:, 2].max()
        ratios.append(math.log(read_mn / largest))
    if not ratios:
        return forces
    # A normal prior of the logarithm about 0, and readings that each err by READING_SD.
    precision = 1 / forces.relative_sd**2 + len(ratios) / READING_SD**2
    factor = math.exp(sum(ratios) / READING_SD**2 / precision)
    # The map's own error along a stroke is in no mean over readings.
    return replace(
        forces,
        steps_mn=tuple(factor * step for step in forces.steps_mn),
        relative_sd=math.hypot(precision**-0.5, READING_SD),
        scale_readings=len(ratios),
    )

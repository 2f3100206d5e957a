"""What a device needs of a calibrated map, as sections of the model card: contacts, heights of the skin, forces."""

import math
from dataclasses import asdict, replace

import numpy as np

from softslide.features.card import Card
from softslide.features.contact.calibration import ContactCalibration, encoded
from softslide.features.contact.force_map import ForceMap, in_steps
from softslide.features.force import STEP_MM, ForceReader
from softslide.features.height import HeightCalibration
from softslide.features.rest_height import rest_height
from softslide.features.stream.conditioning import ONSETS, Conditioning
from softslide.features.track_estimate import PARTIAL_UNKNOWNS
from softslide.models.response_map.from_atlas import depth_slope
from softslide.models.response_map.map import (
    PARTS,
    SPACING_MM,
    ResponseMap,
    half_of,
    spline_coefficients,
    spline_grid,
)
from softslide.models.response_map.slides import StaticScatter, static_outputs
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import laser_readings_mm
from softslide.pipeline.skin.lines import PER_BOARD

SCALE = "force_mn"  # column of the manifest: the largest normal force of the stroke that a scale read
# Without a scale the force is as uncertain as the modulus, which it is proportional to at a given height: the article
# has 0.07 MPa, the data sheet of Ecoflex 00-10 8 psi = 0.055 MPa at 100 % (a factor of 1.27).
MODULUS_SD = 0.24
# And as the height: fitted to slides and not read; the force grows by a quarter a mm (experiments/LOG.md).
HEIGHT_SD_MM = 0.5
FORCE_PER_MM = 0.25
# Of one reading over the map: what the map's shape is off along a stroke (another mesh, experiments/LOG.md).
READING_SD = 0.05


def contact_calibration(
    response: ResponseMap, inflation_v_per_mm: tuple[float, ...] = (), static: StaticScatter | None = None
) -> ContactCalibration:
    """What a device needs of the map to track contacts. inflation_v_per_mm: (C,), by which the output at rest changes
    as the skin rises, empty where not known. static: of the output at rest."""
    # With fewer channels than a contact that is pressed on has unknowns a wrong place fits as well: of touch-downs 21 %
    # were wrong where 12 are with the larger residual of all outputs (experiments/LOG.md).
    grows, weak_v = response.channels > PARTIAL_UNKNOWNS, response.weak_floor_v
    text, scale = encoded(np.concatenate([response.coefficients, response.depth_slope[None]]))
    return ContactCalibration(
        coefficients=text,
        scale_v=scale,
        knots=response.coefficients.shape[1],
        half_mm=response.half_mm,
        spacing_mm=response.spacing_mm,
        chamber_mm=response.chamber_mm,
        depth_mm=response.depth_mm,
        noise_v=tuple(float(v) for v in response.noise_v),
        floor_v=weak_v if grows and weak_v else float(response.floor_v),
        floor_share=response.floor_share if grows else None,
        gain_sd=float(response.gain_sd),
        depth_sd_mm=response.depth_sd_mm or ContactCalibration.depth_sd_mm,
        inflation_v_per_mm=inflation_v_per_mm,
        static_v=() if static is None else tuple(static.mean_v.tolist()),
        static_covariance_v2=() if static is None else tuple(map(tuple, static.covariance_v2.tolist())),
    )


def response_of(card: Card) -> ResponseMap:
    """The map that a card carries: without the lag, which its conditioning undoes, and the drift, which it has not.

    Raises:
        ValueError: it has no section `contact`.
    """
    contact = card.contact
    if contact is None:
        raise ValueError("the card carries no response map")
    surfaces = contact.splines()
    response = ResponseMap(
        surfaces[:PARTS],
        surfaces[PARTS],
        (contact.chamber_mm[0], contact.chamber_mm[1]),
        card.reference_mm,
        depth_mm=contact.depth_mm,
        noise_v=np.array(contact.noise_v),
        floor_v=contact.floor_v,
        floor_share=contact.floor_share,
        gain_sd=contact.gain_sd,
        axes=len(card.conditioning.touch_axes),
        rim=card.conditioning.onset == ONSETS[0],
        spacing_mm=contact.spacing_mm,
    )
    if card.heights is None:
        return response
    return replace(
        response,
        height_mm=card.heights.height_mm,
        height_slope=card.heights.splines(response.channels),
        height_range_mm=(card.heights.lowest_mm, card.heights.highest_mm),
    )


def calibrated_heights(response: ResponseMap) -> HeightCalibration | None:
    """What a device needs to know of the skin's height; None where the slides have one."""
    if response.height_slope is None:
        return None
    text, scale = encoded(response.height_slope)
    return HeightCalibration(
        coefficients=text,
        scale_v=scale,
        knots=len(response.height_slope),
        height_mm=response.height_mm,
        lowest_mm=response.height_range_mm[0],
        highest_mm=response.height_range_mm[1],
    )


def static_heights_mm(
    folder: Folder, conditioning: Conditioning, contact: ContactCalibration, heights: HeightCalibration | None
) -> dict[str, float]:
    """The skin's height at each recording that its own static output shows, by name, as on a device."""
    boards = [asdict(board) for board in folder.sensor.accelerometers]
    rest = rest_height(contact, heights, boards, conditioning.scale)
    if rest is None or not rest.shows:
        return {}
    statics = static_outputs(folder, conditioning).items()
    return {name: height for name, v in statics if not math.isnan(height := rest.height_mm(v))}


def force_map(
    atlas: Atlas, chamber_mm: tuple[float, float], height_mm: float, depth_mm: float, friction: float = 1.0
) -> ForceMap:
    """The map that the atlas gives for a skin height and a contact depth, both brought into the atlas.

    friction: over the design's.
    """
    height_mm = float(np.clip(height_mm, atlas.height_mm[0], atlas.height_mm[-1]))
    depth_mm = float(np.clip(depth_mm, atlas.depth_mm[0], atlas.depth_mm[-1]))
    level, half = atlas.pressure_at(height_mm), half_of(chamber_mm)
    x, y = spline_grid(half)
    forces = slice(PER_BOARD * atlas.boards, None)

    def parts_mn(depth: float) -> np.ndarray:
        return 1e3 * np.nan_to_num(atlas.friction_parts(x, y, depth, level, forces))

    parts, slope = parts_mn(depth_mm), depth_slope(atlas, depth_mm, lambda depth: parts_mn(depth)[:, 0])
    surfaces = (parts[:, 0], friction * parts[:, 1], friction * parts[:, 2], slope)
    splines = np.stack([spline_coefficients(values, half) for values in surfaces])
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

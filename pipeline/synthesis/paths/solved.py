"""A contact along a path solved on the skin, step by step: friction follows the path, and a press its own way down.

What the atlas says of a path is put together from straight lines; this is not, and takes seconds a path.
"""

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.solved_line import channels, skin_of
from softslide.pipeline.synthesis.paths.contact_path import ContactPath

# Way between two solved places, up and down included. With half of it outputs change by less than 0.1 % of the largest
# (root mean square), where a lift is over by up to 1.5 % (experiments/LOG.md).
STEP_MM = 0.25
# Time between the places that the way is measured at: 0.05 mm at 25 mm/s.
FINE_S = 0.002


def solved_response(
    design: Sensor, path: ContactPath, atlas: Atlas, time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """As `path_response`, of the skin of a design that the atlas was solved for.

    Raises:
        InputError: no equilibrium was found at a place of the path.
    """
    skin = skin_of(design)
    pressure, inflated = skin.inflate_to(path.height_mm)
    fine = np.arange(0.0, path.duration_s + FINE_S, FINE_S)
    moments = path.at(fine)
    place = np.column_stack([moments.place_mm, moments.depth_mm])
    way = np.append(0.0, np.linalg.norm(np.diff(place, axis=0), axis=1).cumsum())
    at = np.append(np.arange(0.0, way[-1], STEP_MM), way[-1])
    moves = np.append(True, np.diff(way) > 0)
    knots = np.column_stack([np.interp(at, way[moves], axis[moves]) for axis in place.T])
    knots[:, 2] = design.skin_thickness_mm + design.indenter_diameter_mm / 2 - knots[:, 2]
    postures, forces = skin.slide(inflated, pressure, knots)
    solved = [p for p in postures if p is not None]
    if len(solved) < len(postures):
        x, y = knots[len(solved), :2]
        raise InputError(f"{path.name}: no equilibrium at ({x:.1f}, {y:.1f}) mm; choose another seed")
    values = np.column_stack([np.array([channels(skin, p, inflated) for p in solved]), forces])
    now = np.interp(time_s, fine, way)
    response = np.column_stack([np.interp(now, at, channel) for channel in values.T])
    return response, np.hypot(*path.at(time_s).velocity_mm_s.T)

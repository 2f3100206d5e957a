"""A contact along a path: what the atlas says of it at any time, and the truth that its file keeps."""

import numpy as np
import pandas as pd

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.truth import COLUMNS
from softslide.pipeline.synthesis.paths.contact_path import ContactPath
from softslide.pipeline.synthesis.paths.partial_contact import partial_friction_parts, touch_depth_mm

# Rate of a truth file.
TRUTH_HZ = 100.0


def path_response(path: ContactPath, atlas: Atlas, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The atlas's channels (n, channels) at (n,) s, without any lag; and the speed (n,) mm/s.

    Raises:
        InputError: the path leaves the atlas's depths or heights, or passes a position that was not solved.
    """
    moments = path.at(time_s)
    x, y = moments.place_mm.T
    parts = partial_friction_parts(atlas, x, y, moments.depth_mm, path.height_mm)
    if np.isnan(parts).any():
        raise InputError(f"{path.name} passes a position that was not solved; choose another path")
    drag = (moments.friction[:, :, None] * parts[:, 1:]).sum(axis=1)
    return parts[:, 0] + drag, np.hypot(*moments.velocity_mm_s.T)


def path_truth(path: ContactPath, atlas: Atlas) -> pd.DataFrame:
    """What was so, as `pipeline.recordings.truth` says. Contact begins at the depth of the first touch."""
    time_s = np.arange(int(path.duration_s * TRUTH_HZ) + 1) / TRUTH_HZ
    moments = path.at(time_s)
    x, y = moments.place_mm.T
    contact = moments.depth_mm > touch_depth_mm(x, y, path.height_mm, atlas)
    columns = (time_s, x, y, *moments.velocity_mm_s.T, contact.astype(int), moments.depth_mm)
    return pd.DataFrame(dict(zip(COLUMNS, columns, strict=True)))

"""One trial of a sweep: a fit, judged on held-out calibration lines. Imported by worker processes."""

import math
from typing import Any

from experiments.kept_map import kept_map
from features.errors import InputError
from models.registry import fit_model
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder


def held_out_errors(model: str, folder: Folder, settings: Any, atlas: Atlas | None) -> dict[str, float]:
    """Mean errors at the whole stroke on held-out lines of the folder: direction deg, speed %, distance mm.

    Raises:
        InputError: the model cannot be fitted, or there are too few lines to hold some out.
    """
    summary = fit_model(model, folder, settings, atlas=atlas, calibrate=kept_map).summary
    if "heldout_log_speed" in summary:
        summary = summary | {"heldout_speed_percent": 100.0 * summary["heldout_log_speed"]}
    try:
        return {name: summary[f"heldout_{name}"] for name in ("direction_deg", "speed_percent", "offset_mm")}
    except KeyError:
        raise InputError(
            f"{folder.root}: too few lines to hold some out; record more calibration slides"
        ) from None


def overall(errors: dict[str, float]) -> float:
    """The errors' geometric mean: an improvement of a tenth counts alike in each."""
    return math.exp(sum(math.log(max(error, 1e-9)) for error in errors.values()) / len(errors))

"""Accuracy with few recordings: the response map from a number of calibration slides, inverted on every test slide.

No network is trained: the recordings determine the map, and its inversion by least squares (models/cnn/inversion.py)
shows how accurate it is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.provenance import data_tags
from experiments.tracking.study import tracked_study
from features.errors import InputError
from models.cnn.fit import CnnConfig
from models.cnn.inversion import Inversion
from models.held_out import signed_errors
from models.response_map.select import calibrated_map
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.library import atlas_of
from pipeline.recordings.at_rest import conditioning_for
from pipeline.recordings.base_motion import without_base_motion
from pipeline.recordings.derived_labels import recordings_to_learn_from
from pipeline.recordings.folder import Folder, read_folder
from pipeline.recordings.manifest import read_table
from pipeline.recordings.windows import LabelledWindows, labelled_windows


def few(
    recordings: Path,
    slides: Sequence[int],
    draws: int,
    splits: Sequence[str],
    plan: Path | None = None,
    store: str | None = None,
) -> Iterator[dict[str, float]]:
    """`study` of a folder, with the atlas of its sensor's design; or `planned`, where a plan's CSV names recordings.

    Sensors that are no accelerometers have no such atlas: their maps come from the recordings alone. A run is logged,
    with one below it for each draw. store: as in `tracking.store.store_address`.

    Raises:
        InputError: as in `study` and `planned`, or the folder or its sensor is not valid.
    """
    folder = without_base_motion(read_folder(recordings))
    atlas = atlas_of(folder.sensor) if folder.sensor.measures_gravity else None
    rows = (
        study(folder, slides, draws, splits, atlas)
        if plan is None
        else iter([planned(folder, plan, splits, atlas)])
    )
    configuration = {
        "recordings": str(recordings),
        "slides": list(slides),
        "draws": draws,
        "splits": list(splits),
        "plan": None if plan is None else str(plan),
    }
    tags = data_tags(folder)
    name = f"few on {folder.sensor.name}"
    with tracked_study("few", name, configuration, Path("few"), tags=tags, store=store) as (_, part):
        for row in rows:
            settings: dict[str, float] = {key: row[key] for key in row if key in ("slides", "draw")}
            part(f"{row['slides']} slides", settings, {k: v for k, v in row.items() if k not in settings})
            yield row


def study(
    folder: Folder, counts: Sequence[int], draws: int, splits: Sequence[str], atlas: Atlas | None
) -> Iterator[dict[str, float]]:
    """Mean and largest errors at the end of the stroke for each number of slides and each random draw of them.

    Raises:
        InputError: a negative number of slides, no draw, or no labelled slide of the splits.
    """
    if min(counts) < 0:
        raise InputError(f"{min(counts)}: take 0 slides or more", "slides")
    if draws < 1:
        raise InputError(f"{draws}: take at least one", "draws")
    taught = recordings_to_learn_from(folder)
    names = list(taught.manifest.index)
    scored = _scored(folder, splits)
    for count in counts:
        for draw in range(draws if 0 < count < len(names) else 1):
            chosen = np.random.default_rng(draw).choice(len(names), min(count, len(names)), replace=False)
            part = replace(taught, manifest=taught.manifest.loc[[names[n] for n in np.sort(chosen)]])
            yield {"slides": len(part), "draw": draw, **_result(part, scored, atlas)}


def planned(folder: Folder, plan: Path, splits: Sequence[str], atlas: Atlas | None) -> dict[str, float]:
    """The same errors for the calibration slides that a plan names.

    Raises:
        InputError: the plan names no recordings, or others than the folder's calibration slides.
    """
    taught = recordings_to_learn_from(folder)
    names = read_table(plan).get("recording", pd.Series(dtype=str))
    unknown = [name for name in names if name not in taught.manifest.index]
    if unknown or not len(names):
        what = (
            f"'{unknown[0]}' is no calibration slide of {folder.root}" if unknown else "it names no recording"
        )
        raise InputError(f"{plan}: {what}; plan it from this folder's manifest")
    part = replace(taught, manifest=taught.manifest.loc[sorted(names)])
    return {"slides": len(part), **_result(part, _scored(folder, splits), atlas)}


def _scored(folder: Folder, splits: Sequence[str]) -> Folder:
    scored = folder.select(*splits).labelled()
    if not len(scored):
        raise InputError(f"{folder.root}: no labelled slide of a split {' or '.join(splits)}*; name another")
    return scored


def _result(part: Folder, scored: Folder, atlas: Atlas | None) -> dict[str, float]:
    """Errors on the slides `scored` of the map calibrated on `part`."""
    config = CnnConfig()
    conditioning = conditioning_for(part, config.conditioning)
    found = calibrated_map(part, atlas, conditioning, config.calibration, config.spread)
    windows = labelled_windows(scored, found.conditioning, (1.0,))
    inversion = Inversion(found.response, found.conditioning.block_s)
    rows = inversion.predict(windows.volts, windows.elapsed_s)
    return _errors(rows, inversion.outputs, windows)


def _errors(rows: np.ndarray, outputs: tuple[str, ...], windows: LabelledWindows) -> dict[str, float]:
    signed = signed_errors(rows, outputs, windows)
    errors = {
        "direction_deg": np.abs(signed["direction_deg"]),
        "speed_percent": 100 * np.abs(np.expm1(signed["log_speed"])),
        "offset_mm": np.abs(signed["offset_mm"]),
    }
    return {
        f"{name}_{what}": round(float(of(values)), 4)
        for name, values in errors.items()
        for what, of in (("mean", np.mean), ("max", np.max))
    }

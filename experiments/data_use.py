"""What `train` is about to do with a folder's recordings, and what it did, said on standard error."""

import sys

import pandas as pd

from models.fitted_model import FittedModel
from pipeline.recordings.derived_labels import why_not_labelled, with_derived_labels
from pipeline.recordings.folder import Folder

EXAMPLES = 3  # recordings named for each reason


def report_plan(model: str, chosen: Folder, folder: Folder, design: bool, last_s: float | None) -> None:
    """Says, before anything that takes time, what is trained on what, and how long it may take.

    chosen: the recordings of the calibration splits. folder: those to learn from. design: whether an atlas is used.
    last_s: how long the last such training took, s; None: not known.
    """
    left_out = len(chosen) - len(folder)
    source = f"{len(folder)} recordings" if len(folder) else "the design alone"
    parts = [f"training {model} of {folder.sensor.name} from {source}"]
    if len(folder) and design:
        parts[0] += " and the design's atlas"
    if left_out:
        parts.append(f"{left_out} of {len(chosen)} left out")
    if last_s is not None:
        parts.append(f"the last {model} on this computer took {_time(last_s)}")
    print("; ".join(parts), file=sys.stderr)


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"


def report_use(chosen: Folder, folder: Folder, fitted: FittedModel) -> None:
    """Says how many recordings were used, and of those that were not, why not.

    chosen: those of the calibration splits. folder: what the model was fitted to.
    """
    left_out = why_not_labelled(with_derived_labels(chosen)) | fitted.left_out
    print(f"learnt from {len(chosen) - len(left_out)} of {len(chosen)} recordings", file=sys.stderr)
    for line in (*_left_out(left_out), *_assumed(chosen, folder, fitted)):
        print(line, file=sys.stderr)


def _left_out(left_out: dict[str, str]) -> list[str]:
    reasons: dict[str, list[str]] = {}
    for name, reason in left_out.items():
        reasons.setdefault(reason, []).append(name)
    return [f"left out {len(names)}: {reason} ({_some(names)})" for reason, names in reasons.items()]


def _assumed(chosen: Folder, folder: Folder, fitted: FittedModel) -> list[str]:
    """What is not as labelled in the recordings used."""
    lines = []
    if fitted.untimed:
        lines.append(
            f"fitted the onset of {fitted.untimed}: no start_x_mm, start_y_mm, motion_start_s or motion_end_s; "
            "the skin's lag and a common delay of all slides cannot be told from such labels"
        )
    table = chosen.manifest.loc[folder.manifest.index]
    if (absent := table["depth_mm"].isna()).any():
        depths = folder.manifest["depth_mm"][absent].unique()
        lines.append(f"no depth_mm in {int(absent.sum())}: taken as {depths[0]:g} mm")
    if "skin_height_mm" in table:
        heights = pd.to_numeric(table["skin_height_mm"], errors="coerce").dropna()
        if heights.nunique() > 1:
            lines.append(
                f"skin_height_mm from {heights.min():g} to {heights.max():g} mm: one response map for all of them"
            )
    contact = folder.manifest["depth_mm"]
    if contact.nunique() > 1:
        lines.append(
            f"depth_mm from {contact.min():g} to {contact.max():g}: any depth between them is expected"
        )
    return lines


def _some(names: list[str]) -> str:
    return ", ".join(names[:EXAMPLES]) + (", ..." if len(names) > EXAMPLES else "")

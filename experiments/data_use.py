"""What `train` is about to do with a folder's recordings, and what it did, said on standard error."""

import sys
from dataclasses import asdict

import numpy as np

from softslide.features.height import HeightCalibration
from softslide.features.rest_height import rest_height
from softslide.features.stream.conditioning import Conditioning
from softslide.models.fitted_model import FittedModel
from softslide.models.response_map.slides import LEAST_APART_MM
from softslide.pipeline.recordings.at_rest import REFERENCE_V_PER_G
from softslide.pipeline.recordings.base_motion import moved_and_left
from softslide.pipeline.recordings.derived_labels import why_not_labelled, with_derived_labels
from softslide.pipeline.recordings.folder import Folder

EXAMPLES = 3  # recordings named for each reason
TRIGGER_RMS = 3.0  # what is left of the base's motion reaches three times its rms every few seconds


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


def report_use(chosen: Folder, folder: Folder, fitted: FittedModel, several_heights: bool = False) -> None:
    """Says how many recordings were used, and of those that were not, why not.

    chosen: those of the calibration splits. folder: what the model was fitted to. several_heights: whether the model
    can be fitted to recordings at several heights of the skin.
    """
    left_out = why_not_labelled(with_derived_labels(chosen), several_heights) | fitted.left_out
    print(f"learned from {len(chosen) - len(left_out)} of {len(chosen)} recordings", file=sys.stderr)
    for line in (*_left_out(left_out), *_assumed(chosen, folder, fitted)):
        print(line, file=sys.stderr)


def report_base(whole: Folder) -> None:
    """Says how far the base moved in the recordings that show how the skin follows it, and what is left."""
    if whole.base_motion is None:
        return
    moved_g, before_v, left_v = moved_and_left(whole)
    sensitivity = float(np.median([a.sensitivity_v_per_g for a in whole.sensor.accelerometers]))
    shown_v = Conditioning().trigger_v * sensitivity / REFERENCE_V_PER_G
    late = whole.sensor.measures_gravity and left_v > shown_v / TRIGGER_RMS
    ask = (
        "; as much shows as contacts: are both sampled at the same time, and does nothing touch?"
        if late
        else ""
    )
    assert whole.sensor.base is not None
    unit = whole.sensor.accelerometers[0].unit
    moved_in = "g" if whole.sensor.base.measures_gravity else unit
    size, unit = (1e3, "mV") if unit == "V" else (1.0, unit)
    print(
        f"the base moved by {', '.join(f'{g:.2f}' for g in moved_g[::-1])} {moved_in} rms along three axes; of the "
        f"{size * before_v:.0f} {unit} that the skin followed it by {size * left_v:.1f} {unit} are left{ask}",
        file=sys.stderr,
    )


def _left_out(left_out: dict[str, str]) -> list[str]:
    reasons: dict[str, list[str]] = {}
    for name, reason in left_out.items():
        reasons.setdefault(reason, []).append(name)
    return [f"left out {len(names)}: {reason} ({some(names)})" for reason, names in reasons.items()]


def _assumed(chosen: Folder, folder: Folder, fitted: FittedModel) -> list[str]:
    """What is not as labelled in the recordings used."""
    lines = []
    if fitted.untimed:
        lines.append(
            f"fitted the onset of {fitted.untimed}: no start_x_mm, start_y_mm, motion_start_s or motion_end_s; "
            "such labels do not separate the skin's lag from a common delay of all slides"
        )
    table = chosen.manifest.loc[folder.manifest.index]
    if (absent := table["depth_mm"].isna()).any():
        depths = folder.manifest["depth_mm"][absent].unique()
        lines.append(f"no depth_mm in {int(absent.sum())}: taken as {depths[0]:g} mm")
    if fitted.heights is not None:
        boards, scale = [asdict(board) for board in folder.sensor.accelerometers], fitted.conditioning.scale
        rest = None if fitted.contact is None else rest_height(fitted.contact, fitted.heights, boards, scale)
        shown = rest is not None and rest.shows
        lines.append(_over_heights(fitted.heights, shown, fitted.summary))
    contact = folder.manifest["depth_mm"]
    if np.ptp(contact) > LEAST_APART_MM:
        between = f"depth_mm from {contact.min():g} to {contact.max():g}"
        lines.append(f"{between}: any depth between them is expected")
    return lines


def _over_heights(heights: HeightCalibration, shown: bool, summary: dict[str, float]) -> str:
    """What was made of recordings at several heights of the skin. shown: whether the static output shows them."""
    line = f"skin {heights.lowest_mm:.2f} to {heights.highest_mm:.2f} mm high: one response map over heights"
    if "heldout_residual_map_a_height" in summary:
        shared, apart = (summary[f"heldout_residual_map_{name}"] for name in ("over_heights", "a_height"))
        line += f", which leaves {shared:.1%} of held-out lines (a map of each height {apart:.1%})"
    return f"{line}; the static output shows {'the height' if shown else 'no height, name it by --height'}"


def some(names: list[str], most: int = EXAMPLES) -> str:
    """The first of these in a line."""
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")

"""`report.html`: can this bundle be trusted here? One file that opens anywhere, without a network."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.evaluation import figures, track_figures, tracks
from softslide.experiments.evaluation.bounds import WORDS, Verdict
from softslide.experiments.evaluation.scoring import QUANTITIES
from softslide.experiments.evaluation.tables import SHOWN, error_table, track_table
from softslide.experiments.evaluation.traces import trace
from softslide.experiments.evaluation.tracks import Track
from softslide.experiments.flattened import flattened
from softslide.experiments.pages.figures import Panel
from softslide.experiments.pages.page import number, render
from softslide.features.stream.conditioning import Conditioning
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import CALIBRATION

TEMPLATE = Path(__file__).parent / "report.html.j2"
# Labels whose range is shown, with their names and units.
RANGES = {
    "true_speed_mm_s": ("Speeds", "mm/s"),
    "true_depth_mm": ("Contact depths", "mm"),
    "true_pressure_mpa": ("Pressures", "MPa"),
}
WORST = 3


def write_report(
    path: Path,
    metrics: dict[str, Any],
    verdicts: Sequence[Verdict],
    scored: pd.DataFrame,
    followed: Sequence[Track],
    folder: Folder,
) -> None:
    """Writes the report on `evaluate.measure`'s metrics, the scored predictions and the tracks behind them.

    scored: without slides along calibration lines. folder: with all splits, of which calibration's lines are drawn.
    """
    sensor = folder.sensor
    end = scored[scored["stroke_fraction"] == 1.0]
    ends = {split: strokes["1.0"] for split, strokes in metrics["splits"].items() if "1.0" in strokes}
    calibration = folder.manifest[folder.manifest["split"].str.startswith(CALIBRATION)]
    learned = metrics["calibration_lines"]
    along = {"calibration lines": learned["end_of_stroke"]} if learned["names"] else {}
    tables = {
        "By split": ends,
        "By direction": metrics["by_direction"],
        "By distance from the accelerometer": metrics["by_distance"],
        "By speed": metrics["by_speed"],
        "By share of the stroke seen": metrics["overall"],
        "Along calibration lines, apart": along,
    }
    text = render(
        TEMPLATE,
        metrics=metrics,
        words=WORDS,
        answer=answer(verdicts),
        untested=not_tested(end, verdicts, sensor.chamber_mm),
        tables=[(title, error_table(groups)) for title, groups in tables.items()],
        shown=SHOWN,
        units=QUANTITIES,
        origin=sensor.origin,
        covered_map=figures.coverage(scored, calibration, sensor),
        groups=[
            ("By direction of motion", figures.by_angle(end)),
            ("By place on the skin", figures.by_place(scored, sensor)),
            ("As the stroke goes on", figures.along_the_stroke(scored)),
            ("Do the intervals hold?", figures.interval_coverage(scored)),
            ("Recording by recording", figures.recording_by_recording(end, verdicts)),
        ],
        bound_panels=figures.over_bound(metrics["over_bound"] or {}),
        worst=worst(scored, folder),
        silent=[str(name) for name in end.loc[~end["valid"].astype(bool), "recording"]],
        tracks=track_table(metrics.get("tracks", {})),
        whole_contacts=track_table(metrics.get("whole_contacts", {})),
        track_panels=track_figures.along_the_contact(followed),
        track_pictures=[
            (split, track_figures.pictures(part, sensor)) for split, part in tracks.by_split(followed).items()
        ],
        card=_lines(metrics["bundle"]["card"]),
    )
    path.write_text(text, encoding="utf-8")


def answer(verdicts: Sequence[Verdict]) -> tuple[str, str]:
    """Can it be trusted here? "met", "missed" or "untested", and a sentence."""
    missed = [f"“{v.bound.name}”" for v in verdicts if v.met is False]
    untested = [f"“{v.bound.name}”" for v in verdicts if v.met is None]
    met = len(verdicts) - len(missed) - len(untested)
    so_many = f"{met} of {len(verdicts)}"
    if missed:
        return "missed", f"Not within the article's bounds: {', '.join(missed)} missed, {so_many} met."
    if not met:
        return "untested", "No straight slide tests the article's bounds here: figures, no verdict."
    if untested:
        return (
            "untested",
            f"As far as it was tested: {so_many} bounds met; not tested: {', '.join(untested)}.",
        )
    return "met", f"Yes, where it was tested: all {met} of the article's bounds are met."


def not_tested(end: pd.DataFrame, verdicts: Sequence[Verdict], chamber_mm: tuple[float, float]) -> list[str]:
    """What the scored recordings leave open, a sentence each. end: rows at the end of the stroke, new lines alone."""
    lines = [f"The bound “{v.bound.name}” ({v.bound.says}): {v.untested}." for v in verdicts if v.met is None]
    if end.empty:
        return [*lines, "No recording is along a line that calibration has not seen."]
    if missing := figures.missing_sectors(end["true_direction_deg"].dropna()):
        lines.append(f"Directions near {', '.join(missing)} deg: no recording.")
    for column, (what, unit) in RANGES.items():
        values = end[column].dropna()
        if values.empty:
            lines.append(f"{what}: no recording says.")
        elif np.isclose(values.min(), values.max()):
            lines.append(f"{what} other than {values.min():g} {unit}.")
        else:
            lines.append(f"{what} below {values.min():.3g} and above {values.max():.3g} {unit}.")
    reach = end["true_offset_mm"].abs().max()
    if np.isfinite(reach) and reach < min(chamber_mm) / 2 - 1.0:
        lines.append(f"Lines farther than {reach:.3g} mm from the accelerometer.")
    return [
        *lines,
        "Another sensor of this design, another indenter, other days than those of the recordings.",
    ]


def worst(scored: pd.DataFrame, folder: Folder) -> list[tuple[str, str, list[Panel]]]:
    """The recordings with the largest errors of the position at the end of the stroke (of the direction, where no place
    is labelled): name, what was off, and two panels, path and outputs."""
    end = scored[scored["stroke_fraction"] == 1.0]
    column = "position_mm_error" if end["position_mm_error"].notna().any() else "direction_deg_error"
    largest = end.dropna(subset=[column]).nlargest(WORST, column)
    of = dict(tuple(scored.groupby("recording")))
    return [_shown(row, of[row["recording"]], folder) for _, row in largest.iterrows()]


def _shown(row: pd.Series, rows: pd.DataFrame, folder: Folder) -> tuple[str, str, list[Panel]]:
    name, sensor = str(row["recording"]), folder.sensor
    label = folder.manifest.loc[name]
    motion = label[["motion_start_s", "motion_end_s"]].to_numpy(float)
    text = f"{name}: true line and the {int(rows['valid'].sum())} valid estimates at tenths of the stroke."
    panels = [figures.paths(rows, "recording", sensor, text)]
    if np.isfinite(motion).all():
        channels = [c for c in sensor.channels if c[-1] in sensor.touch_axes][:6]
        over_time = trace(folder, name, Conditioning(), len(sensor.accelerometers))
        panels.append(figures.outputs(over_time, name, channels, motion, sensor.accelerometers[0].unit))
    off = [(word, QUANTITIES[quantity], row[f"{quantity}_error"]) for quantity, word in SHOWN.items()]
    what = (
        f"{row['split']}, {label['direction_deg']:.4g} deg, {label['speed_mm_s']:.3g} mm/s, offset "
        f"{label['offset_mm']:.3g} mm; off by: "
        + ", ".join(f"{word} {number(error)} {unit}" for word, unit, error in off if np.isfinite(error))
    )
    return name, what, panels


def _lines(card: dict[str, Any]) -> list[tuple[str, str]]:
    """The card as lines of a table: nested keys joined by a dot, long lists cut."""
    texts = {
        key: ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        for key, value in flattened(card).items()
    }
    return [(key, text if len(text) <= 160 else text[:157] + "...") for key, text in texts.items()]

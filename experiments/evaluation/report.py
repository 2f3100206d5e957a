"""`report.html`: one file that opens anywhere, without a network."""

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from experiments.evaluation import figures, track_figures, tracks
from experiments.evaluation.scoring import INTERVALS, QUANTITIES
from experiments.evaluation.tracks import Track
from pipeline.sensor import Sensor

TEMPLATE = "report.html.j2"
# Sensors whose recordings are known to come from an emulator of a bench; a report must never read otherwise.
EMULATED = ("bench-a", "bench-d")
QUANTITY_NAMES = {
    "direction_deg": "direction, deg",
    "speed_percent": "speed, %",
    "offset_mm": "distance, mm",
    "position_mm": "position, mm",
}


def write_report(
    path: Path, metrics: dict[str, Any], scored: pd.DataFrame, followed: Sequence[Track], sensor: Sensor
) -> None:
    """Writes the report on `evaluate.measure`'s metrics, the scored predictions and the tracks behind them."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "words": _words}
    end = {split: strokes["1.0"] for split, strokes in metrics["splits"].items() if "1.0" in strokes}
    text = environment.get_template(TEMPLATE).render(
        metrics=metrics,
        verdicts=metrics["bounds"],
        end=metrics["end_of_stroke"],
        taught=metrics["taught_lines"],
        tables=[
            ("By split", end),
            ("By direction", metrics["by_direction"]),
            ("By distance from the accelerometer", metrics["by_distance"]),
            ("By speed", metrics["by_speed"]),
            ("By share of the stroke seen", metrics["overall"]),
        ],
        quantities=QUANTITY_NAMES,
        intervals=INTERVALS,
        units=QUANTITIES,
        worst=_worst(scored),
        emulated=metrics["sensor"] in EMULATED,
        origin=sensor.origin,
        stroke_figure=_inline(figures.along_the_stroke(scored)),
        recording_figure=_inline(figures.recording_by_recording(scored)),
        tracks=metrics.get("tracks", {}),
        tracked=tracks.QUANTITIES,
        covered=tracks.COVERED,
        track_figure=_inline(track_figures.along_the_contact(followed)) if followed else None,
        track_pictures=_pictures(followed, sensor),
        card=_flat(metrics["bundle"]["card"]),
    )
    path.write_text(text, encoding="utf-8")


def _pictures(followed: Sequence[Track], sensor: Sensor) -> list[tuple[str, str]]:
    """For each split its name and an image source."""
    splits = dict.fromkeys(track.split for track in followed)
    return [
        (split, _inline(track_figures.pictures([t for t in followed if t.split == split], sensor)))
        for split in splits
    ]


def number(value: float | None, digits: int = 3) -> str:
    """A number to so many significant digits; a dash where there is none."""
    if value is None or value != value:
        return "–"
    return f"{value:#.{digits}g}".rstrip(".") if abs(value) < 10**digits else f"{value:,.0f}"


def _words(count: int, noun: str) -> str:
    return f"{count} {noun}" + ("" if count == 1 else "s")


def _inline(svg: str) -> str:
    """An image source that holds the image."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()


def _worst(scored: pd.DataFrame, count: int = 5) -> list[tuple[str, list[dict[str, Any]]]]:
    """For each quantity its title and the recordings with the largest errors at the end of the stroke."""
    end = scored[scored["stroke_fraction"] == 1.0]
    return [
        (
            title,
            [
                {
                    "recording": row["recording"],
                    "split": row["split"],
                    "error": row[f"{quantity}_error"],
                    "direction": row["true_direction_deg"],
                    "speed": row["true_speed_mm_s"],
                    "offset": row["true_offset_mm"],
                }
                for row in end.nlargest(count, f"{quantity}_error").to_dict("records")
            ],
        )
        for quantity, title in QUANTITY_NAMES.items()
    ]


def _flat(card: dict[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """The card as lines of a table: nested keys joined by a dot, long lists cut."""
    lines: list[tuple[str, str]] = []
    for key, value in card.items():
        if isinstance(value, dict):
            lines += _flat(value, f"{prefix}{key}.")
        else:
            text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            lines.append((prefix + key, text if len(text) <= 160 else text[:157] + "..."))
    return lines

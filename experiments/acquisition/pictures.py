"""The chamber from above: the slides of a plan, or what a folder's slides cover.

Each is written as the kind that the name's ending says (.svg, .png, .pdf).
"""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from softslide.experiments.evaluation.figures import slide_lines
from softslide.experiments.pages.figures import COLOURS, EDGE, STYLE, draw_sensor
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor

NUMBER_MM = 1.5  # from a line's start back to its number
MM = {"xlabel": "x, mm", "ylabel": "y, mm"}


@mpl.rc_context(STYLE)
def draw_plan(plan: pd.DataFrame, paths: Sequence[np.ndarray], sensor: Sensor, out: Path) -> None:
    """Each slide's line, direction, speed and number; paths are places (n, 2) mm each."""
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    draw_sensor(axes, sensor, width=1.0, label="")
    for part in sensor.accelerometers:
        axes.annotate(part.name, (part.x_mm, part.y_mm), (6, 6), textcoords="offset points")
    for number, places in enumerate(paths):
        axes.plot(*places.T, ".-", color=EDGE, markevery=[0], label="" if number else f"{len(paths)} paths")
    speeds = sorted(set(plan["speed_mm_s"]))
    colour = dict(zip(speeds, mpl.colormaps["viridis"](np.linspace(0.1, 0.8, len(speeds))), strict=True))
    for number, (start, end) in enumerate(slide_lines(plan), 1):
        row, heading = plan.iloc[number - 1], (end - start) / np.linalg.norm(end - start)
        arrow = {"arrowstyle": "-|>", "color": colour[row["speed_mm_s"]], "lw": 1.5}
        axes.annotate("", end, start, arrowprops=arrow)
        x, y = start - NUMBER_MM * heading
        axes.text(x, y, str(number), ha="center", va="center")
    for speed in speeds:
        axes.plot([], [], color=colour[speed], label=f"{speed:g} mm/s")
    x, y = (size / 2 + sensor.indenter_diameter_mm + 4 for size in sensor.chamber_mm)
    title = f"{len(plan)} slides for {sensor.name}"
    axes.set(xlim=(-x, x), ylim=(-y, y), aspect="equal", title=title, **MM)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    _write(figure, out)


@mpl.rc_context(STYLE)
def draw_coverage(folder: Folder, out: Path) -> None:
    """The slides' lines on the skin, and direction against speed."""
    learned = folder.manifest["split"].str.startswith(CALIBRATION)
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    skin, plane = figure.subplots(1, 2)
    for chosen, colour, name in ((~learned, EDGE, "other"), (learned, COLOURS[0], "calibration")):
        rows = folder.manifest[chosen]
        skin.plot(*slide_lines(rows).T, color=colour, linewidth=0.8, alpha=0.7)
        skin.plot([], [], color=colour, label=f"{name} ({len(rows)})")
        plane.plot(rows["direction_deg"], rows["speed_mm_s"], "o", markersize=4, alpha=0.7, color=colour)
    draw_sensor(skin, folder.sensor, width=1.0, label="")
    skin.set(aspect="equal", title=f"slides of {folder.sensor.name}", **MM)
    skin.legend(loc="upper right", fontsize=8)
    plane.set(xlabel="direction, deg", ylabel="speed, mm/s", xlim=(-12, 372), title="direction and speed")
    plane.set_xticks([0, 90, 180, 270, 360])
    _write(figure, out)


def _write(figure: Figure, out: Path) -> None:
    """Writes the picture; the same numbers give the same SVG."""
    figure.savefig(out, metadata={"Date": None} if out.suffix == ".svg" else None)

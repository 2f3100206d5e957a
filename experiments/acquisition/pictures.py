"""The chamber from above: the slides of a plan, or what a folder's slides cover.

Each is written as the kind that the name's ending says (.svg, .png, .pdf).
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from experiments.pages.figures import COLOURS, EDGE, INK, STYLE
from pipeline.recordings.folder import Folder
from pipeline.recordings.learned import CALIBRATION
from pipeline.sensor import Sensor

NUMBER_MM = 1.5  # from a line's start back to its number


def draw_plan(plan: pd.DataFrame, sensor: Sensor, out: Path) -> None:
    """Each slide's line, direction, speed and number."""
    figure = Figure(figsize=(7, 7), layout="constrained")
    axes = figure.subplots()
    _chamber(axes, sensor)
    speeds = sorted(set(plan["speed_mm_s"]))
    colour = dict(zip(speeds, mpl.colormaps["viridis"](np.linspace(0.1, 0.8, len(speeds))), strict=True))
    for part in sensor.accelerometers:
        axes.annotate(part.name, (part.x_mm, part.y_mm), (6, 6), textcoords="offset points")
    for number, (_, row) in enumerate(plan.iterrows(), 1):
        x, y, travel = row["start_x_mm"], row["start_y_mm"], row["travel_mm"]
        cos, sin = np.cos(np.deg2rad(row["direction_deg"])), np.sin(np.deg2rad(row["direction_deg"]))
        arrow = {"arrowstyle": "-|>", "color": colour[row["speed_mm_s"]], "lw": 1.5}
        axes.annotate("", (x + travel * cos, y + travel * sin), (x, y), arrowprops=arrow)
        axes.text(x - NUMBER_MM * cos, y - NUMBER_MM * sin, str(number), ha="center", va="center")
    for speed in speeds:
        axes.plot([], [], color=colour[speed], label=f"{speed:g} mm/s")
    margin = sensor.indenter_diameter_mm + 4
    x, y = (size / 2 + margin for size in sensor.chamber_mm)
    axes.set(xlim=(-x, x), ylim=(-y, y), title=f"{len(plan)} slides for {sensor.name}")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(out)


def draw_coverage(folder: Folder, out: Path) -> None:
    """The slides' lines on the skin, and direction against speed."""
    manifest = folder.manifest
    learned = manifest["split"].str.startswith(CALIBRATION)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 4.2), layout="constrained")
        skin, plane = figure.subplots(1, 2)
        for rows, colour, name in (
            (manifest[~learned], EDGE, "other"),
            (manifest[learned], COLOURS[0], "calibration"),
        ):
            angle = np.deg2rad(rows["direction_deg"].astype(float))
            ends = [
                np.stack([rows[f"start_{axis}_mm"], rows[f"start_{axis}_mm"] + rows["travel_mm"] * part])
                for axis, part in (("x", np.cos(angle)), ("y", np.sin(angle)))
            ]
            skin.plot(*ends, color=colour, linewidth=0.8, alpha=0.7)
            skin.plot([], [], color=colour, label=f"{name} ({len(rows)})")
            plane.plot(rows["direction_deg"], rows["speed_mm_s"], "o", markersize=4, alpha=0.7, color=colour)
        _chamber(skin, folder.sensor)
        skin.set_title(f"slides of {folder.sensor.name}")
        skin.legend(loc="upper right", fontsize=8)
        plane.set(xlabel="direction, deg", ylabel="speed, mm/s", xlim=(-12, 372), title="direction and speed")
        plane.set_xticks([0, 90, 180, 270, 360])
        figure.savefig(out)


def _chamber(axes: Axes, sensor: Sensor) -> None:
    """The chamber's edge and the accelerometers, in mm."""
    width, length = sensor.chamber_mm
    axes.add_patch(Rectangle((-width / 2, -length / 2), width, length, fill=False, edgecolor=INK))
    for part in sensor.accelerometers:
        axes.plot(part.x_mm, part.y_mm, "s", color=INK, markersize=6)
    axes.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")

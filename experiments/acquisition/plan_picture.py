"""A plan as a picture: the chamber from above, with each slide's line, direction, speed and number."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.patches import Rectangle

from pipeline.sensor import Sensor

NUMBER_MM = 1.5  # from a line's start back to its number


def draw_plan(plan: pd.DataFrame, sensor: Sensor, out: Path) -> None:
    """Writes the picture, of the kind that the name's ending says (.svg, .png, .pdf)."""
    width, length = sensor.chamber_mm
    speeds = sorted(set(plan["speed_mm_s"]))
    colour = dict(zip(speeds, plt.colormaps["viridis"](np.linspace(0.1, 0.8, len(speeds))), strict=True))
    figure, axes = plt.subplots(figsize=(7, 7), layout="constrained")
    axes.add_patch(Rectangle((-width / 2, -length / 2), width, length, fill=False, lw=1.5))
    for part in sensor.accelerometers:
        axes.plot(part.x_mm, part.y_mm, "ks", ms=8)
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
    axes.set(
        xlim=(-width / 2 - margin, width / 2 + margin),
        ylim=(-length / 2 - margin, length / 2 + margin),
        xlabel="x, mm",
        ylabel="y, mm",
        title=f"{len(plan)} slides for {sensor.name}",
        aspect="equal",
    )
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.savefig(out)
    plt.close(figure)

"""What a folder's slides cover, as a small picture: their lines on the skin, and direction against speed."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from experiments.pages.figures import COLOURS, EDGE, INK, STYLE
from pipeline.recordings.folder import Folder
from pipeline.recordings.taught import CALIBRATION


def draw_coverage(folder: Folder, out: Path) -> None:
    """Writes the picture, of the kind that the name's ending says (.svg, .png, .pdf)."""
    manifest, sensor = folder.manifest, folder.sensor
    taught = manifest["split"].str.startswith(CALIBRATION)
    half = np.array(sensor.chamber_mm) / 2
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.4, 4.2), layout="constrained")
        skin, plane = figure.subplots(1, 2)
        skin.add_patch(Rectangle((-half[0], -half[1]), *sensor.chamber_mm, fill=False, edgecolor=INK))
        for rows, colour, name in (
            (manifest[~taught], EDGE, "other"),
            (manifest[taught], COLOURS[0], "calibration"),
        ):
            angle = np.deg2rad(rows["direction_deg"].astype(float))
            ends = [
                np.stack([rows[f"start_{axis}_mm"], rows[f"start_{axis}_mm"] + rows["travel_mm"] * part])
                for axis, part in (("x", np.cos(angle)), ("y", np.sin(angle)))
            ]
            skin.plot(*ends, color=colour, linewidth=0.8, alpha=0.7)
            skin.plot([], [], color=colour, label=f"{name} ({len(rows)})")
            plane.plot(rows["direction_deg"], rows["speed_mm_s"], "o", markersize=4, alpha=0.7, color=colour)
        for part in sensor.accelerometers:
            skin.plot(part.x_mm, part.y_mm, "s", color=INK, markersize=6)
        skin.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"slides of {sensor.name}")
        skin.legend(loc="upper right", fontsize=8)
        plane.set(xlabel="direction, deg", ylabel="speed, mm/s", xlim=(-12, 372), title="direction and speed")
        plane.set_xticks([0, 90, 180, 270, 360])
        figure.savefig(out)

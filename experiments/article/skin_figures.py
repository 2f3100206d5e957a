"""Figures 6, 9, 10, 11 and 26: the skin under pressure, from the atlas and from the recordings at rest."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.article.axis_slides import AxisSlides
from softslide.experiments.article.section import Section
from softslide.experiments.article.slide_figures import FROM_BOARD
from softslide.experiments.pages.figures import COLOURS, EDGE, Panel, chart
from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.atlas.static_contact import height_by_atlas, height_by_formula
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.heights import alike_mpa, laser_readings_mm
from softslide.pipeline.sensor import Sensor

DEPTH_MM = 0.5  # the article's
LINE_MM = 10.0  # from the accelerometer, of the slides shown: where the article's method works best
STEP_MM = 0.5
LEVELS = 25  # of the pressure
HEIGHT_LIMIT_PERCENT = 12.0
# Of each pressure, recordings whose static output is read; more say the same.
MOST_AT_REST = 8
LEAST_REST_S = 0.4
MOST_SERIES = 6  # of pressures and depths, those of most slides


def board_slides(atlas: Atlas, sensor: Sensor) -> pd.DataFrame:
    """Tilts (g) of the first board in forward slides LINE_MM from it at each height of the atlas: `height_mm`, `slide`,
    "X" or "Y", `along_mm`, `tilt_x_g`, `tilt_y_g`."""
    board, rows = sensor.accelerometers[0], []
    depth = float(np.clip(DEPTH_MM, atlas.depth_mm[0], atlas.depth_mm[-1]))
    for height in map(float, atlas.height_mm):
        for axis, half in enumerate(atlas.meta["reach_mm"]):
            along = np.arange(-half, half + STEP_MM / 2, STEP_MM)
            line = np.full(len(along), (board.y_mm, board.x_mm)[axis] - LINE_MM)
            x, y = (along, line) if axis == 0 else (line, along)
            tilt = atlas.response(x, y, 90.0 * axis, depth, atlas.pressure_at(height))[:, 0]
            row = {"height_mm": height, "slide": "XY"[axis], "along_mm": along}
            rows.append(pd.DataFrame(row | {"tilt_x_g": tilt[:, 0], "tilt_y_g": tilt[:, 1]}))
    return pd.concat(rows, ignore_index=True)


def simulation(atlas: Atlas, sensor: Sensor) -> Section:
    """Figure 6: how the board's nodes move, in slides along x and y, at several heights of the skin."""
    arm, table, panels = sensor.board.size_mm[0] / 2, board_slides(atlas, sensor), []
    # The end of an axis goes down where the board's reading along it is positive.
    table["node_1_mm"], table["node_2_mm"] = -arm * table["tilt_x_g"], -arm * table["tilt_y_g"]
    for axis, changes in (("X", "x changes its sign, y keeps it"), ("Y", "y changes its sign, x keeps it")):
        one = _named(table[table["slide"] == axis])
        nodes = [one.assign(mm=one[f"node_{n}_mm"], node=f"node {n}, " + one["height"]) for n in (1, 2)]
        text = (
            f"Displacement of the board's nodes, 1 on its x and 2 on its y, against its centre in an {axis}-slide "
            f"{LINE_MM:g} mm from the accelerometer: {changes}."
        )
        labels = (f"{axis}-slide, forward", f"{axis.lower()} of the indenter, mm", "displacement, mm")
        look: dict[str, Any] = {"mark": "-", "colours": COLOURS[: len(atlas.height_mm)]}
        panels.append(chart(pd.concat(nodes), "along_mm", "mm", "node", labels, text, **look))
    largest = table["node_1_mm"].abs().groupby(table["height_mm"]).max()
    found = ", ".join(f"{most:.2g} mm at {height:.3g} mm" for height, most in largest.items())
    return Section(
        "6",
        "Simulation: nodes of the board in slides at several pressures",
        "Abaqus, 47,656 elements: X-slides change the sign of one tilt and keep the other's, Y-slides the other way "
        "round; more pressure, larger displacements.",
        f"Own solver, contact {DEPTH_MM:g} mm deep. Largest displacement of node 1 by skin height: {found}.",
        tuple(panels),
        table,
    )


def static_output(atlas: Atlas, folder: Folder) -> Section:
    """Figures 9 and 11: static output and skin height against pressure; 10: the parabola."""
    sensor = folder.sensor
    solved, recorded = _solved(atlas, sensor), _recorded(atlas, folder)
    table = pd.concat([solved, recorded], ignore_index=True)
    here = f"From the atlas: {_height_sentence(solved, 'height_mm')}."
    if len(recorded):
        one = recorded[["static_x_v", "formula_mm", "atlas_height_mm"]].median()
        here += (
            f" The recordings' static V_x is {1000 * one['static_x_v']:.0f} mV at rest (median of {len(recorded)}): "
            f"{_mm(one['formula_mm'])} by the formula, {_mm(one['atlas_height_mm'])} by the atlas."
        )
    lasers = recorded.dropna(subset=["laser_mm"]).sort_values("laser_mm")
    if len(lasers):
        here += f" Against the laser's readings {_height_sentence(lasers, 'laser_mm')}."
    gaps = [] if len(lasers) else ["no recording holds a laser's reading of the height"]
    if alike_mpa(recorded["pressure_mpa"].dropna()).nunique() < 2:
        gaps.append("the recordings are of one pressure, or do not say which")
    return Section(
        "9 to 11",
        "Static output and skin height against pressure",
        "V_x and V_y rise with the pressure; h = D^2 tan(beta) / (2 x0) from V_x is within 12 % of a laser's reading.",
        here,
        tuple(_static_panels(table, atlas, sensor)),
        table,
        "; ".join(gaps).capitalize() + "." if gaps else "",
    )


def _solved(atlas: Atlas, sensor: Sensor) -> pd.DataFrame:
    levels = np.linspace(atlas.pressure_mpa[0], atlas.pressure_mpa[-1], LEVELS)
    tilt = np.array([atlas.static(float(level))[0, :2] for level in levels])
    volts = sensor.accelerometers[0].sensitivity_v_per_g * tilt
    heights = [atlas.height(float(level)) for level in levels]
    table = pd.DataFrame({"source": "atlas", "effective_pressure_mpa": levels, "height_mm": heights})
    table["static_x_v"], table["static_y_v"] = volts[:, 0], volts[:, 1]
    table["formula_mm"] = [_formula(x, sensor) for x in tilt[:, 0]]
    return table.assign(formula_error_percent=100 * (table["formula_mm"] / table["height_mm"] - 1))


def _recorded(atlas: Atlas, folder: Folder) -> pd.DataFrame:
    """The first board's static output (V, less the zero-g output) of some recordings of each pressure, a laser's
    reading of the skin's height (mm), NaN without one, heights (mm) by the formula and by the atlas, and the formula's
    error (%) against the laser."""
    board, known = folder.sensor.accelerometers[0], folder.manifest["motion_start_s"].notna()
    labels = folder.manifest.assign(laser_mm=laser_readings_mm(folder))[known]
    rows = []
    for _, part in labels.groupby(alike_mpa(labels["pressure_mpa"].dropna()), dropna=False):
        for name, label in part.iloc[:: -(-len(part) // MOST_AT_REST)].iterrows():
            recording = folder.load(str(name))
            rest = recording.time_s < label["motion_start_s"]
            if rest.sum() < LEAST_REST_S * folder.sensor.sample_rate_hz:
                continue
            volts = recording.volts[rest, :2].mean(axis=0) - board.zero_g_v
            tilt = volts / board.sensitivity_v_per_g
            heights = _formula(tilt[0], folder.sensor), _by_atlas(tilt, atlas)
            rows.append((name, label["pressure_mpa"], label["laser_mm"], *volts, "recordings", *heights))
    columns = ["recording", "pressure_mpa", "laser_mm", "static_x_v", "static_y_v", "source"]
    table = pd.DataFrame(rows, columns=[*columns, "formula_mm", "atlas_height_mm"])
    return table.assign(formula_error_percent=100 * (table["formula_mm"] / table["laser_mm"] - 1))


def _static_panels(table: pd.DataFrame, atlas: Atlas, sensor: Sensor) -> list[Panel]:
    solved, lasers = table[table["source"] == "atlas"], table.dropna(subset=["laser_mm"])
    outputs = {f"V_{axis}, solved": 1000 * solved[f"static_{axis}_v"] for axis in "xy"}
    rows = pd.concat([solved.assign(output=name, mv=mv) for name, mv in outputs.items()])
    tops = _named(pd.DataFrame({"height_mm": atlas.height_mm, "x": 0.0}))

    def measured(ax: Axes, columns: Mapping[str, pd.Series]) -> None:
        for n, (name, values) in enumerate(columns.items() if len(lasers) else ()):
            ax.plot(lasers["laser_mm"], values, "x", color=COLOURS[n], label=f"{name}recorded, laser")

    def parabolas(ax: Axes) -> None:
        half = sensor.chamber_mm[0] / 2
        across = np.linspace(-half, half, 60)
        for n, height in enumerate(map(float, atlas.height_mm)):
            top = _formula(atlas.static(atlas.pressure_at(height))[0, 0], sensor)
            ax.plot(across, top * (1 - (across / half) ** 2), color=COLOURS[n % len(COLOURS)])
        ax.axvline(sensor.accelerometers[0].x_mm, color=EDGE, linestyle=":", linewidth=1)

    def limits(ax: Axes) -> None:
        ax.axhspan(-HEIGHT_LIMIT_PERCENT, HEIGHT_LIMIT_PERCENT, color=EDGE, alpha=0.15, linewidth=0)
        measured(ax, {"": lasers["formula_error_percent"]})

    static = partial(measured, columns={f"V_{axis}, ": 1000 * lasers[f"static_{axis}_v"] for axis in "xy"})
    texts = (
        "Static V_x and V_y, less the zero-g output, against the skin's height, which the pressure sets.",
        "Parabolas by the slope at the accelerometer (dotted); dots are the heights that were solved.",
        "Error of the height formula against the solved height and a laser's; the band is the article's 12 %.",
    )
    labels = (
        ("9: static output", "height, mm", "static output, mV"),
        ("10: the parabola through the slope at the board", "x, mm", "height, mm"),
        ("11: height by the formula", "height, mm", "error of the formula, %"),
    )
    error, off = solved.assign(of="solved"), "formula_error_percent"
    return [
        chart(rows, "height_mm", "mv", "output", labels[0], texts[0], mark="-", draw=static),
        chart(tops, "x", "height_mm", "height", labels[1], texts[1], draw=parabolas),
        chart(error, "height_mm", off, "of", labels[2], texts[2], mark="-", colours=COLOURS[1:], draw=limits),
    ]


def pressure(atlas: Atlas, folder: Folder, whole: AxisSlides | None) -> Section:
    """Figure 26: outputs in a Y-slide at several pressures, and the recordings' swing at theirs."""
    table = board_slides(atlas, folder.sensor).query("slide == 'Y'").reset_index(drop=True)
    volts = folder.sensor.accelerometers[0].sensitivity_v_per_g * table[["tilt_x_g", "tilt_y_g"]]
    table[["vx_v", "vy_v"]] = volts
    text = f"V_y in a Y-slide {LINE_MM:g} mm from the accelerometer, by the solved skin's height."
    labels = ("V_y, Y-slide forward", "y of the indenter, mm", "V_y, mV")
    rows = _named(table).assign(mv=1000 * table["vy_v"])
    panels = [chart(rows, "along_mm", "mv", "height", labels, text, mark="-")]
    swing = table.groupby("height_mm")["vy_v"].agg(np.ptp)
    here = "From the atlas, V_y from its lowest to its highest: "
    here += ", ".join(f"{1000 * v:.0f} mV at {h:.3g} mm" for h, v in swing.items()) + "."
    seen, missing = recorded_swings(whole), "The recordings are of one pressure, or do not say which."
    if seen["pressure_mpa"].nunique() > 1:
        missing = ""
        most = seen["series"].value_counts().index[:MOST_SERIES]
        rows = seen[seen["series"].isin(most)].sort_values("series")
        medians = rows[rows["distance_mm"] <= LINE_MM].groupby("series")["swing_mv"].median()
        here += f" Recorded within {LINE_MM:g} mm, medians: "
        here += "; ".join(f"{value:.0f} mV at {name}" for name, value in medians.items()) + "."
        text = "Recorded output along the motion from its lowest to its highest against the distance of the line."
        labels = ("recorded", FROM_BOARD, "lowest to highest, mV")
        panels.append(chart(rows, "distance_mm", "swing_mv", "series", labels, text))
    says = "The output grows with the pressure; 0.045 MPa adds little to 0.035."
    return Section("26", "The role of pressure", says, here, tuple(panels), table, missing)


def recorded_swings(whole: AxisSlides | None) -> pd.DataFrame:
    """Of each slide `pressure_mpa`, `distance_mm`, `swing_mv` of the output along the motion, and `series`: pressure
    and contact depth in words."""
    if whole is None:
        return pd.DataFrame(columns=["pressure_mpa", "distance_mm", "swing_mv", "series"])
    labels = whole.folder.manifest.loc[whole.table["recording"], ["pressure_mpa", "depth_mm"]]
    table = labels.reset_index(drop=True).assign(distance_mm=whole.table["distance_mm"])
    table["swing_mv"] = 1000 * (whole.table["high_v"] - whole.table["low_v"])
    table = table.dropna()
    table["pressure_mpa"] = alike_mpa(table["pressure_mpa"])
    rows = zip(table["pressure_mpa"], table["depth_mm"], strict=True)
    return table.assign(series=[f"{mpa:.3g} MPa, {depth:.1f} mm deep" for mpa, depth in rows])


def _named(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(height=table["height_mm"].map("{:.3g} mm high".format))


def _mm(height: float) -> str:
    return f"{height:.1f} mm" if np.isfinite(height) else "no height (out of range)"


def _formula(static_g: float, sensor: Sensor) -> float:
    """The article's height, mm; NaN where it has none."""
    try:
        return height_by_formula(float(static_g), sensor.accelerometers[0].x_mm, sensor.chamber_mm[0] / 2)
    except InputError:
        return np.nan


def _by_atlas(static_g: np.ndarray, atlas: Atlas) -> float:
    """The atlas's height for one board's static tilts (2,) g, mm; NaN beyond the atlas, or of several boards."""
    try:
        return height_by_atlas(static_g[None], atlas) if atlas.boards == 1 else np.nan
    except InputError:
        return np.nan


def _height_sentence(table: pd.DataFrame, height: str) -> str:
    ends = table.iloc[[0, -1]]
    if ends["formula_mm"].isna().any():
        return "the formula gives no height for this board"
    errors = zip(ends["formula_error_percent"], ends[height], strict=True)
    return "the formula is " + " and ".join(f"{error:+.0f} % off at {mm:.3g} mm" for error, mm in errors)

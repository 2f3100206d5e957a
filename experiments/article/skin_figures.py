"""Figures 6, 9, 10, 11 and 26: the skin under pressure, from the atlas and from the recordings at rest."""

import numpy as np
import pandas as pd

from experiments.article.section import Section
from experiments.evaluation.traces import static_outputs
from experiments.pages.figures import COLOURS, EDGE, INK, Panel, inline, legend_below, panel
from features.errors import InputError
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.static_contact import height_by_atlas, height_by_formula
from pipeline.recordings.folder import Folder
from pipeline.sensor import Sensor

DEPTH_MM = 0.5  # the article's
LINE_MM = 10.0  # from the accelerometer, of the slides shown: where the article's method works best
STEP_MM = 0.5
LEVELS = 25  # of the pressure
HEIGHT_LIMIT_PERCENT = 12.0


def board_slides(atlas: Atlas, sensor: Sensor) -> pd.DataFrame:
    """Tilts (g) of the first board in slides LINE_MM beside it, forward and backward, at each height of the atlas."""
    board, reach = sensor.accelerometers[0], atlas.meta["reach_mm"]
    depth = float(np.clip(DEPTH_MM, atlas.depth_mm[0], atlas.depth_mm[-1]))
    rows = []
    for height in atlas.height_mm:
        level = atlas.pressure_at(float(height))
        for axis, half in enumerate(reach):
            along = np.arange(-half, half + STEP_MM / 2, STEP_MM)
            beside = np.full(len(along), (board.y_mm if axis == 0 else board.x_mm) - LINE_MM)
            x, y = (along, beside) if axis == 0 else (beside, along)
            for sense, heading in (("forward", 90.0 * axis), ("backward", 90.0 * axis + 180.0)):
                tilt = atlas.response(x, y, heading, depth, level)[:, 0]
                rows.append(
                    pd.DataFrame(
                        {
                            "height_mm": float(height),
                            "slide": f"{'XY'[axis]} {sense}",
                            "along_mm": along,
                            "tilt_x_g": tilt[:, 0],
                            "tilt_y_g": tilt[:, 1],
                        }
                    )
                )
    return pd.concat(rows, ignore_index=True)


def simulation(atlas: Atlas, sensor: Sensor) -> Section:
    """Figure 6: how the board's nodes move, in slides along x and y, at several heights of the skin."""
    arm = sensor.board.size_mm[0] / 2
    table = board_slides(atlas, sensor)
    # The end of an axis goes down where the board's reading along it is positive.
    table["node_1_mm"], table["node_2_mm"] = -arm * table["tilt_x_g"], -arm * table["tilt_y_g"]
    panels = []
    for axis in "XY":
        with panel(3.8, below=0.6) as (figure, ax):
            for n, (height, rows) in enumerate(
                table[table["slide"] == f"{axis} forward"].groupby("height_mm")
            ):
                for node, line in (("node_1_mm", "-"), ("node_2_mm", "--")):
                    ax.plot(rows["along_mm"], rows[node], line, color=COLOURS[n])
                ax.plot([], [], color=COLOURS[n], label=f"{height:.3g} mm high")
            ax.plot([], [], "-", color=INK, label="node 1, on the board's x")
            ax.plot([], [], "--", color=INK, label="node 2, on its y")
            ax.set(
                xlabel=f"{axis.lower()} of the indenter, mm",
                ylabel="displacement, mm",
                title=f"{axis}-slide, forward",
            )
            legend_below(figure, ax)
            changes = "x changes its sign, y keeps it" if axis == "X" else "y changes its sign, x keeps it"
            text = (
                f"Displacement of the board's nodes against its centre in an {axis}-slide {LINE_MM:g} mm "
                f"beside the accelerometer: {changes}."
            )
            panels.append(Panel(inline(figure, text), text))
    strength = table.groupby("height_mm")[["node_1_mm", "node_2_mm"]].agg(_largest)
    grows = bool((strength.diff().dropna() > 0).all(axis=None)) if len(strength) > 1 else None
    told = ", ".join(f"{row.iloc[0]:.2g} mm at {height:.3g} mm" for height, row in strength.iterrows())
    return Section(
        "6",
        "Simulation: nodes of the board in slides at several pressures",
        "Abaqus, 47,656 elements: X-slides change the sign of one tilt and keep the other's, Y-slides the other way "
        "round; more pressure, larger displacements.",
        f"The project's own solver, contact {DEPTH_MM:g} mm deep. Largest displacement of node 1 by skin height: {told}"
        + (
            ""
            if grows is None
            else "; it grows with the pressure"
            if grows
            else "; it does not always grow with the pressure"
        )
        + ".",
        tuple(panels),
        table,
    )


def static_output(atlas: Atlas, folder: Folder) -> Section:
    """Figures 9 and 11: static output and skin height against pressure; 10: the parabola."""
    sensor, board = folder.sensor, folder.sensor.accelerometers[0]
    levels = np.linspace(atlas.pressure_mpa[0], atlas.pressure_mpa[-1], LEVELS)
    heights = np.array([atlas.height(float(level)) for level in levels])
    tilt = np.array([atlas.static(float(level))[0, :2] for level in levels])
    table = pd.DataFrame(
        {
            "source": "atlas",
            "effective_pressure_mpa": levels,
            "height_mm": heights,
            "static_x_v": tilt[:, 0] * board.sensitivity_v_per_g,
            "static_y_v": tilt[:, 1] * board.sensitivity_v_per_g,
            "formula_mm": [_formula(t, sensor) for t in tilt[:, 0]],
        }
    )
    table["formula_error_percent"] = 100 * (table["formula_mm"] / table["height_mm"] - 1)
    recorded = static_outputs(folder)
    recorded["formula_mm"] = [_formula(v / board.sensitivity_v_per_g, sensor) for v in recorded["static_x_v"]]
    recorded["atlas_height_mm"] = [
        _solved(row, atlas, board.sensitivity_v_per_g) for row in recorded.to_dict("records")
    ]
    panels = [_static_panel(table), _parabola_panel(table, atlas, sensor), _height_panel(table)]
    here = "From the atlas: " + _height_sentence(table)
    if len(recorded):
        one = recorded[["static_x_v", "formula_mm", "atlas_height_mm"]].median()
        here += (
            f" The recordings' static V_x is {1000 * one['static_x_v']:.0f} mV at rest (median of {len(recorded)}): "
            f"{_mm(one['formula_mm'])} by the formula, {_mm(one['atlas_height_mm'])} by the atlas."
        )
    missing = "No recording holds a laser's reading of the height"
    if recorded["pressure_mpa"].nunique() < 2:
        missing += ", and all are of one pressure: the curve against pressure is the atlas's alone"
    return Section(
        "9 to 11",
        "Static output and skin height against pressure",
        "V_x and V_y rise with the pressure; h = D^2 tan(beta) / (2 x0) from V_x is within 12 % of a laser's reading.",
        here,
        tuple(panels),
        pd.concat([table, recorded.assign(source="recordings")], ignore_index=True),
        missing + ".",
    )


def pressure(atlas: Atlas, folder: Folder) -> Section:
    """Figure 26: outputs in a Y-slide at several pressures."""
    board = folder.sensor.accelerometers[0]
    table = board_slides(atlas, folder.sensor)
    table = table[table["slide"] == "Y forward"].reset_index(drop=True)
    panels = []
    for axis in "xy":
        table[f"v{axis}_v"] = board.sensitivity_v_per_g * table[f"tilt_{axis}_g"]
        with panel() as (figure, ax):
            for n, (height, rows) in enumerate(table.groupby("height_mm")):
                ax.plot(
                    rows["along_mm"],
                    1000 * rows[f"v{axis}_v"],
                    color=COLOURS[n],
                    label=f"{height:.3g} mm high",
                )
            ax.set(xlabel="y of the indenter, mm", ylabel=f"V_{axis}, mV", title=f"V_{axis}, Y-slide forward")
            ax.legend()
            text = f"V_{axis} in a Y-slide {LINE_MM:g} mm beside the accelerometer, by the height of the inflated skin."
            panels.append(Panel(inline(figure, text), text))
    span = table.groupby("height_mm")["vy_v"].agg(np.ptp)
    per_mm = (span.diff() / span.index.to_series().diff()).dropna()
    here = "From the atlas, V_y from its lowest to its highest: " + ", ".join(
        f"{1000 * v:.0f} mV at {h:.3g} mm" for h, v in span.items()
    )
    if len(per_mm) > 1:
        less = per_mm.iloc[-1] < per_mm.iloc[0]
        here += (
            f"; a further millimetre adds {1000 * per_mm.iloc[0]:.0f} mV at first and "
            f"{1000 * per_mm.iloc[-1]:.0f} mV at "
            f"last, so that more pressure {'helps less and less' if less else 'goes on helping'}"
        )
    labels = folder.manifest["pressure_mpa"].dropna().round(4)
    missing = "" if labels.nunique() > 1 else "The recordings are of one pressure, or do not say which."
    return Section(
        "26",
        "The role of pressure",
        "The output grows with the pressure; 0.045 MPa adds little to 0.035.",
        here + ".",
        tuple(panels),
        table,
        missing,
    )


def _largest(values: pd.Series) -> float:
    return float(values.abs().max())


def _mm(height: float) -> str:
    return f"{height:.1f} mm" if np.isfinite(height) else "none (out of range)"


def _formula(static_g: float, sensor: Sensor) -> float:
    """The article's height, mm; NaN where it has none."""
    try:
        return height_by_formula(float(static_g), sensor.accelerometers[0].x_mm, sensor.chamber_mm[0] / 2)
    except InputError:
        return np.nan


def _solved(row: dict, atlas: Atlas, v_per_g: float) -> float:
    """The atlas's height for one board's static output, mm; NaN beyond the atlas, or of several boards."""
    if atlas.boards > 1:
        return np.nan
    try:
        return height_by_atlas(np.array([[row["static_x_v"], row["static_y_v"]]]) / v_per_g, atlas)
    except InputError:
        return np.nan


def _height_sentence(table: pd.DataFrame) -> str:
    ends = table.iloc[[0, -1]]
    if ends["formula_mm"].isna().any():
        return "the formula gives no height for this board."
    return (
        "the formula is "
        + " and ".join(
            f"{error:+.0f} % off at {height:.3g} mm"
            for error, height in zip(ends["formula_error_percent"], ends["height_mm"], strict=True)
        )
        + "."
    )


def _static_panel(table: pd.DataFrame) -> Panel:
    with panel() as (figure, ax):
        for n, axis in enumerate("xy"):
            ax.plot(
                1000 * table["effective_pressure_mpa"],
                1000 * table[f"static_{axis}_v"],
                color=COLOURS[n],
                label=f"V_{axis}",
            )
        ax.set(xlabel="effective pressure, kPa", ylabel="static output, mV", title="9: static output")
        ax.legend()
        text = "Static V_x and V_y, less the zero-g output, against the solved skin's effective pressure."
        return Panel(inline(figure, text), text)


def _parabola_panel(table: pd.DataFrame, atlas: Atlas, sensor: Sensor) -> Panel:
    half, x0 = sensor.chamber_mm[0] / 2, sensor.accelerometers[0].x_mm
    across = np.linspace(-half, half, 60)
    with panel() as (figure, ax):
        for n, height in enumerate(atlas.height_mm):
            static = atlas.static(atlas.pressure_at(float(height)))[0, 0]
            dome = _formula(static, sensor) * (1 - (across / half) ** 2)
            ax.plot(across, dome, color=COLOURS[n], label=f"solved: {height:.3g} mm high")
            ax.plot([0], [height], "o", color=COLOURS[n])
        ax.axvline(x0, color=EDGE, linestyle=":", linewidth=1)
        ax.set(xlabel="x, mm", ylabel="height, mm", title="10: the parabola through the slope at the board")
        ax.legend(fontsize=8, loc="lower center")
        text = "Parabolas by the slope at the accelerometer (dotted); dots are the heights that were solved."
        return Panel(inline(figure, text), text)


def _height_panel(table: pd.DataFrame) -> Panel:
    with panel() as (figure, ax):
        ax.plot(table["height_mm"], table["formula_error_percent"], color=COLOURS[1], label="formula")
        for limit in (-HEIGHT_LIMIT_PERCENT, HEIGHT_LIMIT_PERCENT):
            ax.axhline(limit, color=EDGE, linestyle="--", linewidth=1)
        ax.axhline(0, color=EDGE, linewidth=1)
        ax.set(
            xlabel="solved height, mm", ylabel="error of the formula, %", title="11: height by the formula"
        )
        text = "Error of the article's height formula against the solved height; dashed: the article's 12 %."
        return Panel(inline(figure, text), text)

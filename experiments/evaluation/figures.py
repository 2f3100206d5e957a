"""The report's figures: what the recordings cover, and errors by angle, place, share of the stroke and recording."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.projections.polar import PolarAxes

from experiments.evaluation.bounds import Verdict
from experiments.evaluation.scoring import INTERVALS
from experiments.pages.figures import (
    COLOURS,
    EDGE,
    INK,
    LEGEND_ROW_INCHES,
    Panel,
    draw_sensor,
    inline,
    legend_below,
    log_with_zero,
    panel,
)
from pipeline.sensor import Sensor

# Column of the scores, word and unit, of what is shown of every recording.
SHOWN = (
    ("direction_deg", "direction error", "deg"),
    ("speed_percent", "speed error", "%"),
    ("offset_mm", "distance error", "mm"),
)
LABELS = {
    "direction_deg": ("true_direction_deg", "direction, deg"),
    "speed_percent": ("true_speed_mm_s", "speed, mm/s"),
    "offset_mm": ("true_offset_mm", "offset, mm"),
}
SECTOR_DEG = 30.0
CELL_MM = 10.0
INTERVAL = 0.9
_Z90 = 1.645  # of a two-sided 90 % interval of a normal distribution


def coverage(scored: pd.DataFrame, calibration: pd.DataFrame, sensor: Sensor) -> Panel:
    """The lines of calibration and of scored recordings on the skin. calibration: rows of a manifest."""
    end = scored[scored["stroke_fraction"] == 1.0]
    splits = list(end.groupby("split"))
    rows_below = (len(splits) + 3) // 2
    with panel(4.1 + LEGEND_ROW_INCHES * rows_below, below=LEGEND_ROW_INCHES * rows_below) as (figure, ax):
        _chamber(ax, sensor)
        taught = _lines(calibration)
        for line in taught:
            ax.plot(*line, color=EDGE, linewidth=0.7, alpha=0.6)
        if taught:
            ax.plot([], [], color=EDGE, linewidth=0.7, label=f"calibration ({len(taught)})")
        for n, (split, rows) in enumerate(splits):
            lines = _lines(rows, "true_")
            for line in lines:
                ax.plot(*line, color=COLOURS[n % len(COLOURS)], linewidth=1.0, alpha=0.8)
            ax.plot([], [], color=COLOURS[n % len(COLOURS)], label=f"{split} ({len(lines)})")
        legend_below(figure, ax)
        text = "Lines of the recordings on the skin, by split, with their number; what no line passes is not tested."
        return Panel(inline(figure, text), text)


def by_angle(end: pd.DataFrame) -> list[Panel]:
    """Errors at the end of the stroke by the direction of motion, a polar panel a quantity."""
    panels = []
    for quantity, word, unit in SHOWN:
        rows = end[end[f"{quantity}_error"].notna() & end["true_direction_deg"].notna()]
        if rows.empty:
            continue
        error, angle = rows[f"{quantity}_error"], np.deg2rad(rows["true_direction_deg"].to_numpy())
        sector = ((rows["true_direction_deg"] + SECTOR_DEG / 2) % 360 // SECTOR_DEG).astype(int)
        means, counts = error.groupby(sector).mean(), error.groupby(sector).size()
        with panel(3.9, projection="polar") as (figure, ax):
            assert isinstance(ax, PolarAxes)
            width = np.deg2rad(0.9 * SECTOR_DEG)
            ax.bar(
                np.deg2rad(SECTOR_DEG * means.index.to_numpy()),
                means,
                width=width,
                color=COLOURS[5],
                alpha=0.55,
                linewidth=0,
            )
            ax.plot(angle, error, "o", markersize=3, color=COLOURS[0], alpha=0.8)
            top = 1.15 * max(float(error.max()), 1e-9)
            ax.set_ylim(0, top)
            ax.yaxis.set_major_locator(mpl.ticker.MaxNLocator(3))
            ax.set_rlabel_position(15)
            figure.text(0.02, 0.95, f"{word}, {unit}")
            empty = [SECTOR_DEG * k for k in range(int(360 / SECTOR_DEG)) if k not in counts.index]
            text = (
                f"{word.capitalize()} ({unit}) by direction of motion: bars are means of {SECTOR_DEG:g} deg, "
                "dots recordings"
            )
            text += f"; none near {', '.join(f'{a:g}' for a in empty)} deg." if empty else "."
            panels.append(Panel(inline(figure, text), text))
    return panels


def by_place(scored: pd.DataFrame, sensor: Sensor) -> list[Panel]:
    """Mean position error by where the contact is, and share of moments with a valid estimate, over the skin."""
    angle = np.deg2rad(scored["true_direction_deg"])
    way = scored["stroke_fraction"] * scored["true_travel_mm"]
    x = scored["true_start_x_mm"] + way * np.cos(angle)
    y = scored["true_start_y_mm"] + way * np.sin(angle)
    cells = pd.DataFrame(
        {"i": np.floor(x / CELL_MM + 0.5), "j": np.floor(y / CELL_MM + 0.5)}
        | {"error": scored["position_mm_error"], "valid": scored["valid"].astype(float)}
    )
    half = np.array(sensor.chamber_mm) / 2
    inside = cells[(x.abs() <= half[0]) & (y.abs() <= half[1])].groupby(["i", "j"])
    if not len(inside):
        return []
    errors, valid = inside["error"].mean().dropna(), inside["valid"].mean()
    panels = []
    if len(errors):
        text = (
            f"Mean error of the position (mm) by where the contact is, in cells of {CELL_MM:g} mm, over valid "
            "estimates at every "
            "tenth of the stroke; blank: none."
        )
        panels.append(_map(errors, sensor, "position error, mm", text, "{:.2g}"))
    text = "Share of moments (%) with a valid estimate by where the contact is; early moments of a slide have none."
    panels.append(_map(100 * valid, sensor, "valid estimates, %", text, "{:.0f}"))
    return panels


def along_the_stroke(scored: pd.DataFrame) -> list[Panel]:
    """Mean error of each split against the share of the stroke seen, a panel a quantity."""
    panels = []
    for quantity, word, unit in SHOWN:
        means = scored.groupby(["split", "stroke_fraction"])[f"{quantity}_error"].mean().dropna()
        if means.empty:
            continue
        with panel() as (figure, ax):
            for n, (split, rows) in enumerate(means.groupby("split")):
                ax.plot(
                    rows.index.get_level_values(1),
                    rows,
                    "o-",
                    markersize=3,
                    color=COLOURS[n % len(COLOURS)],
                    label=split,
                )
            log_with_zero(ax, means.to_numpy())
            ax.set(xlabel="share of the stroke seen", xlim=(0.05, 1.05), title=f"mean {word}, {unit}")
            ax.legend(fontsize=8)
            text = f"Mean {word} ({unit}) of valid estimates by the share of the stroke seen, a line a split."
            panels.append(Panel(inline(figure, text), text))
    return panels


def interval_coverage(scored: pd.DataFrame) -> list[Panel]:
    """Share of labels in their 90 % interval by split, with the range that the number of recordings leaves."""
    panels = []
    for column, (_, word, _) in zip(INTERVALS, SHOWN, strict=True):
        rows = scored[scored[f"{column}_covered"].notna()]
        if rows.empty:
            continue
        groups = [(str(split), part) for split, part in rows.groupby("split")][::-1]
        with panel(0.9 + 0.42 * len(groups), left=1.6) as (figure, ax):
            ax.axvline(100 * INTERVAL, color=INK, linestyle="--", linewidth=1)
            for n, (_, part) in enumerate(groups):
                share, count = part[f"{column}_covered"].mean(), part["recording"].nunique()
                low, high = wilson(share, count)
                ax.plot([100 * low, 100 * high], [n, n], color=COLOURS[0], linewidth=1.5)
                ax.plot(100 * share, n, "o", color=COLOURS[0], markersize=5)
            ax.set_yticks(
                range(len(groups)), [f"{split} ({part['recording'].nunique()})" for split, part in groups]
            )
            ax.set(xlim=(-3, 103), ylim=(-0.6, len(groups) - 0.4), xlabel="labels within the interval, %")
            ax.set_title(word.removesuffix(" error"))
            ax.grid(axis="y", visible=False)
            text = (
                f"Share of labels within the 90 % interval of the {word.removesuffix(' error')}, by split "
                "with the number of "
                "recordings; bars: what chance leaves open with so many recordings."
            )
            panels.append(Panel(inline(figure, text), text))
    return panels


def recording_by_recording(end: pd.DataFrame, verdicts: Sequence[Verdict]) -> list[Panel]:
    """Error of each recording at the end of its stroke against its label, with the article's bound."""
    limits = {v.bound.quantity: v.bound.limit for v in reversed(verdicts)}
    panels = []
    for quantity, word, unit in SHOWN:
        label, title = LABELS[quantity]
        rows = end[end[f"{quantity}_error"].notna() & end[label].notna()]
        if rows.empty:
            continue
        with panel() as (figure, ax):
            for n, (split, part) in enumerate(rows.groupby("split")):
                ax.plot(
                    part[label],
                    part[f"{quantity}_error"],
                    "o",
                    markersize=3,
                    alpha=0.8,
                    color=COLOURS[n % len(COLOURS)],
                    label=split,
                )
            drawn = rows[f"{quantity}_error"].to_numpy(float)
            if limit := limits.get(quantity):
                ax.axhline(limit, color=INK, linestyle="--", linewidth=1)
                drawn = np.append(drawn, limit)
            log_with_zero(ax, drawn)
            _label_axis(ax, quantity)
            ax.set(xlabel=title, title=f"{word}, {unit}")
            ax.legend(fontsize=8)
            text = f"{word.capitalize()} ({unit}) of each of {len(rows)} recordings at the end of the stroke"
            text += f"; dashed: the article's bound, {limit:g} {unit}." if limit else "."
            panels.append(Panel(inline(figure, text), text))
    return panels


def path(rows: pd.DataFrame, sensor: Sensor) -> Panel:
    """One recording's true line, and the places estimated at each tenth of the stroke."""
    label = rows.iloc[-1]
    with panel(4.1, below=0.2) as (figure, ax):
        _chamber(ax, sensor)
        for line in _lines(rows.iloc[-1:], "true_"):
            ax.plot(*line, color=EDGE, linewidth=5, alpha=0.5, label="true")
        said = rows[rows["valid"].astype(bool)]
        ax.plot(
            said["x_mm"], said["y_mm"], "o-", markersize=3, linewidth=1, color=COLOURS[0], label="estimated"
        )
        legend_below(figure, ax, columns=3)
        text = f"{label['recording']}: true line and the {len(said)} valid estimates at tenths of the stroke."
        return Panel(inline(figure, text), text)


def outputs(
    table: pd.DataFrame, name: str, channels: Sequence[str], motion_s: np.ndarray, unit: str = "V"
) -> Panel:
    """One recording's subtracted outputs over time, with the time of the motion shaded. table: of `traces.trace`.

    unit: of the outputs; volts are shown in mV.
    """
    factor, shown = (1000, "mV") if unit == "V" else (1, unit)
    with panel() as (figure, ax):
        if np.isfinite(motion_s).all():
            ax.axvspan(motion_s[0], motion_s[1], color=EDGE, alpha=0.12, linewidth=0)
        thin = table.iloc[:: max(1, len(table) // 300)]
        for n, channel in enumerate(channels):
            ax.plot(thin["time_s"], factor * thin[channel], color=COLOURS[n % len(COLOURS)], label=channel)
        ax.set(xlabel="time, s", ylabel=f"subtracted output, {shown}", title=name)
        ax.legend(fontsize=8)
        text = f"{name}: outputs less the static output; shaded: the motion."
        return Panel(inline(figure, text), text)


def wilson(share: float, count: int) -> tuple[float, float]:
    """90 % interval of a share seen in so many independent trials (E. B. Wilson, J. Am. Stat. Assoc. 22 (1927) 209)."""
    spread = _Z90**2 / count
    middle = (share + spread / 2) / (1 + spread)
    half = np.sqrt(spread * share * (1 - share) + spread**2 / 4) / (1 + spread)
    return float(middle - half), float(middle + half)


def _label_axis(ax: Axes, quantity: str) -> None:
    if quantity == "direction_deg":
        ax.set_xlim(-12, 372)
        ax.set_xticks([0, 90, 180, 270, 360])
    if quantity == "speed_percent":
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(mpl.ticker.FixedLocator([0.5, 1, 2, 4, 8, 13]))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_locator(mpl.ticker.NullLocator())


def _chamber(ax: Axes, sensor: Sensor) -> None:
    x, y = np.array(sensor.chamber_mm) / 2
    draw_sensor(ax, sensor, width=1.2, label="sensor")
    ax.set(xlim=(-x - 6, x + 6), ylim=(-y - 6, y + 6), aspect="equal", xlabel="x, mm", ylabel="y, mm")


def _lines(rows: pd.DataFrame, prefix: str = "") -> list[tuple[np.ndarray, np.ndarray]]:
    """x and y (2,) mm of the ends of each row's line; rows without start, direction or travel have none."""
    columns = [prefix + name for name in ("start_x_mm", "start_y_mm", "direction_deg", "travel_mm")]
    known = rows[columns].dropna().to_numpy(float)
    ends = np.array([0.0, 1.0])
    return [
        (x + ends * travel * np.cos(np.deg2rad(angle)), y + ends * travel * np.sin(np.deg2rad(angle)))
        for x, y, angle, travel in known
    ]


def _map(values: pd.Series, sensor: Sensor, title: str, text: str, form: str) -> Panel:
    """Cells of the skin in colour, each with its number."""
    colours: Any = mpl.colormaps["viridis"]
    scale = mpl.colors.Normalize(0.0, max(float(values.max()), 1e-9))
    half = np.array(sensor.chamber_mm) / 2
    with panel(4.1) as (figure, ax):
        for place, value in values.items():
            i, j = np.array(place, dtype=float)
            low = np.maximum(CELL_MM * np.array([i - 0.5, j - 0.5]), -half)
            high = np.minimum(CELL_MM * np.array([i + 0.5, j + 0.5]), half)
            ax.add_patch(
                mpl.patches.Rectangle(tuple(low), *(high - low), facecolor=colours(scale(value)), linewidth=0)
            )
            ink = "#ffffff" if scale(value) < 0.6 else "#000000"
            x, y = (low + high) / 2
            ax.text(x, y, form.format(value), ha="center", va="center", color=ink, fontsize=8)
        _chamber(ax, sensor)
        ax.grid(visible=False)
        ax.set_title(title)
        return Panel(inline(figure, text), text)

"""Figures 21 and 22: estimated against actual speed and distance."""

from collections.abc import Mapping

import numpy as np
import pandas as pd

from experiments.article.scoring import Scored, at_end
from experiments.article.section import Section
from experiments.pages.figures import COLOURS, EDGE, INK, Panel, inline, log_with_zero, panel

SPEED_LIMIT, DISTANCE_LIMIT = 8.0, 15.0  # %, the article's


def estimates(results: Mapping[str, Scored], axis: int) -> Section:
    """Figures 21 and 22: estimated against actual speed and distance, of slides that were not fitted."""
    letter, figures = "XY"[axis], ("21", "22")[axis]
    ends = {name: at_end(scored.new, axis) for name, scored in results.items()}
    title = f"Estimated against actual speed and distance, {letter}-slides"
    limit = ("5 <= |y| <= 17.5", "10 <= x <= 22.5")[axis]
    article = (
        f"Speed within 8 % in the detectable area, distance within 15 % for {limit} mm, about 40 % at 2.5 mm."
    )
    if all(end.empty for end in ends.values()):
        return Section(figures, title, article, missing=f"No {letter}-slide to test on in this folder.")
    panels = [
        _against(ends, "speed_mm_s", "true_speed_mm_s", "speed, mm/s", SPEED_LIMIT, letter),
        _against(ends, "distance", "distance_mm", "distance, mm", DISTANCE_LIMIT, letter),
        _errors(
            ends,
            "speed_percent_error",
            "true_speed_mm_s",
            "speed, mm/s",
            "speed error, %",
            SPEED_LIMIT,
            letter,
        ),
        _errors(
            ends,
            "offset_percent_error",
            "distance_mm",
            "distance, mm",
            "distance error, %",
            DISTANCE_LIMIT,
            letter,
        ),
    ]
    on = next(iter(results.values())).on
    here = f"On {on}. " + " ".join(f"{name.capitalize()}: {_sentence(end)}" for name, end in ends.items())
    columns = [
        "recording",
        "split",
        "true_speed_mm_s",
        "speed_mm_s",
        "speed_percent_error",
        "distance_mm",
        "offset_mm",
    ]
    columns += ["true_offset_mm", "offset_percent_error", "valid"]
    table = pd.concat([end[columns].assign(method=name) for name, end in ends.items()], ignore_index=True)
    return Section(figures, title, article, here, tuple(panels), table)


def _sentence(end: pd.DataFrame) -> str:
    answered = end[end["valid"]]
    if answered.empty:
        return "no slide is answered."
    return (
        f"{len(answered)} of {len(end)} slides answered, speed {answered['speed_percent_error'].mean():.1f} % "
        "off on average and "
        f"{answered['speed_percent_error'].max():.0f} % at most, distance "
        f"{answered['offset_mm_error'].mean():.2f} mm and "
        f"{answered['offset_mm_error'].max():.2f} mm."
    )


def _against(
    ends: Mapping[str, pd.DataFrame], said: str, true: str, title: str, limit: float, letter: str
) -> Panel:
    with panel() as (figure, ax):
        longest = max(float(end[true].max()) for end in ends.values() if len(end))
        line = np.array([0, 1.05 * longest])
        ax.plot(line, line, color=EDGE, linewidth=1)
        ax.fill_between(
            line, line * (1 - limit / 100), line * (1 + limit / 100), color=EDGE, alpha=0.2, linewidth=0
        )
        for n, (name, end) in enumerate(ends.items()):
            rows = end[end["valid"]]
            beyond = int((rows[said] > 1.5 * longest).sum())
            label = name + (f" ({beyond} beyond)" if beyond else "")
            ax.plot(
                rows[true], rows[said], "o", markersize=3, alpha=0.7, color=COLOURS[(1, 0)[n]], label=label
            )
        ax.set(
            xlabel=f"actual {title}",
            ylabel=f"estimated {title}",
            title=title.split(",")[0],
            ylim=(0, 1.5 * longest),
        )
        ax.legend(fontsize=8)
        text = (
            f"Estimated against actual {title.split(',')[0]} of {letter}-slides that were not fitted; the "
            f"band is the article's {limit:g} %."
        )
        return Panel(inline(figure, text), text)


def _errors(
    ends: Mapping[str, pd.DataFrame], error: str, label: str, of: str, title: str, limit: float, letter: str
) -> Panel:
    with panel() as (figure, ax):
        drawn = []
        for n, (name, end) in enumerate(ends.items()):
            rows = end[end["valid"] & end[error].notna()]
            drawn.append(rows[error].to_numpy(float))
            ax.plot(
                rows[label], rows[error], "o", markersize=3, alpha=0.7, color=COLOURS[(1, 0)[n]], label=name
            )
        ax.axhline(limit, color=INK, linestyle="--", linewidth=1)
        log_with_zero(ax, np.concatenate([*drawn, [limit]]))
        ax.set(xlabel=of, title=title)
        ax.legend(fontsize=8)
        text = (
            f"{title.split(',')[0].capitalize()} of each {letter}-slide; dashed: the article's {limit:g} %."
        )
        return Panel(inline(figure, text), text)

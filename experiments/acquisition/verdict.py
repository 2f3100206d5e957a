"""What is known while a plan is recorded: slides done and to come, the error so far, and whether it is enough."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from softslide.experiments.acquisition.error_so_far import COLUMNS, NEWEST, ErrorSoFar, read_goal
from softslide.experiments.acquisition.waypoints import waypoints_of
from softslide.experiments.evaluation.scoring import QUANTITIES, WORDS
from softslide.experiments.pages.figures import COLOURS, EDGE, Panel, chart, on_skin
from softslide.experiments.pages.page import panels_page
from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.staging import writing

REFRESH_S = 5
GROSS_DEG = 20.0  # an error that shows another slide than planned, or none
TITLES = {name: f"{word}, {QUANTITIES[name]}" for name, word in WORDS.items()}


class Verdict:
    """Of a plan that is recorded into a growing folder.

    until: errors that are enough, as `read_goal` takes them; empty: none is. page: an HTML file that shows all of it
    and loads itself anew; None: none. slides: the plan, by recording. atlas: of the sensor's design, if it has one.

    Raises:
        InputError: as `read_goal`.
    """

    def __init__(
        self, until: Sequence[str], page: Path | None, slides: pd.DataFrame, atlas: Atlas | None
    ) -> None:
        self._goal, self._page, self._slides = read_goal(until), page, slides
        self._errors, self._said = ErrorSoFar(atlas), ""

    def is_enough(self, folder: Folder, say: Callable[[str], None]) -> bool:
        """Whether the NEWEST slides to learn from have errors that are in the mean no larger than asked for.

        Says what they are where that is new, and writes the page.
        """
        enough = False
        try:
            newest = self._errors.newest(folder)
        except InputError as error:
            text = f"the error so far is not known: {error}"
        else:
            text, mean = _in_words(newest), newest.mean()
            reached = all(mean[name] <= asked for name, asked in self._goal.items())
            if enough := bool(self._goal) and len(newest) == NEWEST and reached:
                text += "; that is enough, no more slides to learn from"
        if text not in ("", self._said):
            say(text)
        self._said = text
        if self._page is not None:
            self._write(self._page, folder, text)
        return enough

    def _write(self, page: Path, folder: Folder, text: str) -> None:
        done = self._slides.index.isin(folder.manifest.index)
        lines = [
            f"{done.sum()} of {len(self._slides)} slides are recorded.",
            text.capitalize() or "The error so far is not known yet.",
        ]
        panels = [
            self._skin(folder, done),
            *(self._course(name) for name in TITLES if len(self._errors.rows)),
        ]
        html = panels_page(f"Recording {folder.root.name}", lines, [("Plan and error so far", panels)])
        again = f'<head>\n<meta http-equiv="refresh" content="{REFRESH_S}">'
        with writing(page, "name another file"):
            page.write_text(html.replace("<head>", again, 1), encoding="utf-8")

    def _skin(self, folder: Folder, done: np.ndarray) -> Panel:
        def draw(ax: Axes) -> None:
            for chosen, colour, name in ((~done, EDGE, "to come"), (done, COLOURS[2], "done")):
                for _, row in self._slides[chosen].iterrows():
                    ax.plot(*waypoints_of(row)[:, 1:3].T, color=colour, linewidth=1.0)
                ax.plot([], [], color=colour, label=f"{name} ({chosen.sum()})")

        caption = "The plan's slides on the skin, from above: those recorded and those to come."
        return on_skin(folder.sensor, caption, draw, "slides")

    def _course(self, name: str) -> Panel:
        errors = self._errors.rows[name].reset_index(drop=True)
        errors.index += 1
        mean, sd = (getattr(errors.rolling(NEWEST, min_periods=2), of)() for of in ("mean", "std"))
        of_mean = sd / errors.rolling(NEWEST, min_periods=2).count() ** 0.5

        def band(ax: Axes) -> None:
            low, high = mean - of_mean, mean + of_mean
            of = f"mean of the last {NEWEST}, and its standard error"
            ax.fill_between(errors.index, low, high, color=COLOURS[1], alpha=0.25, linewidth=0)
            ax.plot(errors.index, mean, color=COLOURS[1], label=of)

        table = pd.DataFrame({"slide": errors.index, "error": errors.to_numpy(), "of": "each slide"})
        dashed = " Dashed: enough." if name in self._goal else ""
        caption = f"Errors of {TITLES[name]}: each slide estimated by the map of those before it.{dashed}"
        labels = (TITLES[name], "slide scored", "error")
        look: dict[str, Any] = {"limit": self._goal.get(name), "draw": band, "ylim": (0, None)}
        return chart(table, "slide", "error", "of", labels, caption, **look)


def _in_words(newest: pd.DataFrame) -> str:
    """Mean errors, with the standard errors that the slides' scatter gives them; empty where there are none."""
    count = len(newest)
    if not count:
        return ""
    mean, of_mean = newest.mean(), newest.std() / count**0.5
    figures = (
        f"{mean[name]:.2g}" + (f" ± {of_mean[name]:.1g} {unit}" if count > 1 else f" {unit}")
        for unit, name in COLUMNS.items()
    )
    text = f"error so far, of the last {count}: {', '.join(figures)}"
    lost = int((newest["direction_deg"] > GROSS_DEG).sum())
    if lost > 1:
        text += f"; {lost} of them go another way than planned: see wiring, drift and where the stage is"
    return text

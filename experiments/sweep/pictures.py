"""A search's pictures and report: errors trial by trial, and how much each setting matters."""

from collections.abc import Callable
from functools import partial

import numpy as np
import optuna
from matplotlib.axes import Axes
from optuna.trial import FrozenTrial, TrialState

from experiments.pages.figures import COLOURS, MARGINS, Panel, inline, panel, svg
from experiments.pages.page import panels_page

# fANOVA's forest splits trials on each setting: with fewer there is nothing to split.
LEAST_TRIALS = 4
# A caption for each picture.
CAPTIONS = {
    "history": "Geometric mean of the errors on held-out lines, trial by trial; a cross was given up midway, at the "
    "error that it had by then.",
    "importance": "How much of the variance of the errors over the space each setting explains (fANOVA, Hutter, Hoos "
    "and Leyton-Brown 2014).",
}
# The left margin in inches: settings have long names.
LEFT = {"history": MARGINS[0], "importance": 1.7}
Draw = Callable[[Axes], None]


def pictures(study: optuna.Study) -> dict[str, str]:
    """SVG texts by name: the history of the errors; and, with enough trials that differ, the settings' importance."""
    return {name: _drawn(draw, svg, LEFT[name]) for name, draw in _draws(study).items()}


def report(study: optuna.Study, best: FrozenTrial, settings: str) -> str:
    """A page with the pictures. settings: the best ones, as TOML."""
    counted = {
        state: len(study.get_trials(states=[state])) for state in (TrialState.COMPLETE, TrialState.PRUNED)
    }
    panels = [
        Panel(_drawn(draw, partial(inline, alt=name), LEFT[name]), CAPTIONS[name])
        for name, draw in _draws(study).items()
    ]
    lines = [
        f"{counted[TrialState.COMPLETE]} trials ended, {counted[TrialState.PRUNED]} were given up midway. The best is "
        f"trial {best.number}: {best.value:.4g}, with:",
        *settings.splitlines(),
    ]
    return panels_page(f"sweep {study.study_name}", lines, [("Errors and settings", panels)])


def _draws(study: optuna.Study) -> dict[str, Draw]:
    ended = study.get_trials(states=[TrialState.COMPLETE])
    numbers = [trial.number for trial in ended]
    values = np.array([trial.value for trial in ended], dtype=float)
    given_up = study.get_trials(states=[TrialState.PRUNED])

    def history(ax: Axes) -> None:
        ax.plot(numbers, values, "o", markersize=4, color=COLOURS[0], label="a trial")
        if given_up:
            last = [trial.value or 0.0 for trial in given_up]
            ax.plot([t.number for t in given_up], last, "x", markersize=4, color=COLOURS[2], label="given up")
        ax.plot(numbers, np.minimum.accumulate(values), color=COLOURS[1], label="best so far")
        ax.set_xlabel("trial")
        ax.set_ylabel("error, geometric mean")
        ax.legend(frameon=False)

    draws: dict[str, Draw] = {"history": history}
    if len(ended) >= LEAST_TRIALS and np.ptp(values) > 0:
        shares = optuna.importance.get_param_importances(
            study, evaluator=optuna.importance.FanovaImportanceEvaluator(seed=0)
        )

        def importance(ax: Axes) -> None:
            ax.barh(list(shares)[::-1], list(shares.values())[::-1], color=COLOURS[0])
            ax.set_xlabel("share of the variance of the errors")

        draws["importance"] = importance
    return draws


def _drawn(draw: Draw, as_text: Callable[..., str], left: float) -> str:
    with panel(left=left) as (figure, ax):
        draw(ax)
        return as_text(figure)

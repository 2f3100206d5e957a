"""A search's pictures: errors trial by trial, and how much each setting matters."""

from collections.abc import Callable

import numpy as np
import optuna
from matplotlib.axes import Axes
from optuna.trial import TrialState

from experiments.pages.figures import COLOURS, panel, svg

# fANOVA's forest splits trials on each setting: with fewer there is nothing to split.
LEAST_TRIALS = 4


def pictures(study: optuna.Study) -> dict[str, str]:
    """SVG texts by name: the history of the errors; and, with enough trials that differ, the settings' importance."""
    ended = study.get_trials(states=[TrialState.COMPLETE])
    numbers = [trial.number for trial in ended]
    values = np.array([trial.value for trial in ended], dtype=float)

    def history(ax: Axes) -> None:
        ax.plot(numbers, values, "o", markersize=4, color=COLOURS[0], label="a trial")
        ax.plot(numbers, np.minimum.accumulate(values), color=COLOURS[1], label="best so far")
        ax.set_xlabel("trial")
        ax.set_ylabel("error, geometric mean")
        ax.legend(frameon=False)

    drawn = {"history": _picture(history)}
    if len(ended) >= LEAST_TRIALS and np.ptp(values) > 0:
        # Hutter, Hoos and Leyton-Brown 2014: a setting's share of the variance of the errors over the space.
        shares = optuna.importance.get_param_importances(
            study, evaluator=optuna.importance.FanovaImportanceEvaluator(seed=0)
        )

        def importance(ax: Axes) -> None:
            ax.barh(list(shares)[::-1], list(shares.values())[::-1], color=COLOURS[0])
            ax.set_xlabel("share of the variance of the errors")

        drawn["importance"] = _picture(importance)
    return drawn


def _picture(draw: Callable[[Axes], None]) -> str:
    with panel() as (figure, ax):
        draw(ax)
        return svg(figure)

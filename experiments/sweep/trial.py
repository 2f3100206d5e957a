"""One trial of a sweep: a fit, judged on held-out calibration lines. Imported by worker processes."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import optuna
from optuna.trial import FrozenTrial

from experiments.kept_map import kept_map
from features.errors import InputError
from models.fitted_model import Given
from models.registry import fit_model, model_named
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder

QUANTITIES = ("direction_deg", "speed_percent", "offset_mm")
# A trial is given up where it is among the worst quarter of those that ended, at the same share of their training;
# never before so many have ended.
KEPT_PERCENT, LEAST_ENDED = 75.0, 5


@dataclass(frozen=True)
class Outcome:
    """errors: of the fit by quantity; empty where the trial was given up. so_far: what `overall` gave after so many
    thirds of the training."""

    errors: dict[str, float] = field(default_factory=dict)
    so_far: dict[int, float] = field(default_factory=dict)


class _GivenUp(Exception):
    """The trial is hopeless."""


def run_trial(
    model: str, folder: Folder, settings: Any, atlas: Atlas | None, earlier: Sequence[FrozenTrial] = ()
) -> Outcome:
    """Errors on held-out lines of the folder: of cnn also as training goes on, which is given up where it is hopeless.

    earlier: trials that ended, which it is held against.

    Raises:
        InputError: the model cannot be fitted, or there are too few lines to hold some out.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    pruner = optuna.pruners.PercentilePruner(KEPT_PERCENT, n_startup_trials=LEAST_ENDED)
    # In memory: a worker may be on another computer than the journal.
    study = optuna.create_study(pruner=pruner)
    study.add_trials([trial for trial in earlier if trial.intermediate_values])
    trial, so_far = study.ask(), {}

    def judge(thirds: int, summary: dict[str, float]) -> None:
        so_far[thirds] = overall(errors_of(summary))
        trial.report(so_far[thirds], thirds)
        if trial.should_prune():
            raise _GivenUp

    try:
        given = Given(atlas, calibrate=kept_map, judge=judge)
        summary = fit_model(model_named(model), folder, settings, given).summary
    except _GivenUp:
        return Outcome({}, so_far)
    try:
        return Outcome(errors_of(summary), so_far)
    except KeyError:
        raise InputError(
            f"{folder.root}: too few lines to hold some out; record more calibration slides"
        ) from None


def errors_of(summary: dict[str, float]) -> dict[str, float]:
    """Mean errors at the whole stroke on held-out lines: direction deg, speed %, distance mm.

    Raises:
        KeyError: no line was held out.
    """
    if "heldout_log_speed" in summary:
        summary = summary | {"heldout_speed_percent": 100.0 * summary["heldout_log_speed"]}
    return {name: summary[f"heldout_{name}"] for name in QUANTITIES}


def overall(errors: dict[str, float]) -> float:
    """The errors' geometric mean: an improvement of a tenth counts alike in each."""
    return math.exp(sum(math.log(max(error, 1e-9)) for error in errors.values()) / len(errors))

"""Which settings of a model have the least errors on calibration lines held out of the fit.

Optuna varies the few settings that matter (of cnn and trees) on a folder's calibration splits; test splits are never
read. Prints each trial's errors at the whole stroke in deg, % and mm, and their geometric mean, which is made least;
then the best settings as TOML for `softslide train --config`. With --storage trials are kept: the same command goes on
with them, and a second process shares the work. A trial of cnn takes minutes.

    python -m softslide.experiments.studies.sweep --recordings lab --storage sqlite:///sweep.db --out best.toml
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import tomli_w

from softslide.experiments.kept_map import kept_map
from softslide.experiments.provenance import data_hashes
from softslide.experiments.studies.script import Part, count, parser, recordings, run
from softslide.experiments.train import design_for
from softslide.features.errors import InputError
from softslide.models.fitted_model import Given
from softslide.models.registry import fit_model, model_named
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.derived_labels import recordings_to_learn_from
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.toml_tables import changed

# Of cnn, at a third or two of the training; no trial is given up before five have ended.
PRUNERS = {"median": optuna.pruners.MedianPruner(), "none": optuna.pruners.NopPruner()}
# A table as of `train --config` with the values that a trial has.
SETTINGS: dict[str, Callable[[optuna.Trial], dict[str, Any]]] = {
    "cnn": lambda trial: {
        "training": {"rate": trial.suggest_float("rate", 5e-4, 1e-2, log=True)},
        "calibration": {
            "smooth_mean": trial.suggest_float("smooth_mean", 0.02, 0.5, log=True),
            "smooth_friction": trial.suggest_float("smooth_friction", 0.5, 20.0, log=True),
        },
    },
    "trees": lambda trial: {
        "trees": trial.suggest_int("trees", 20, 120, log=True),
        "least_leaf": trial.suggest_int("least_leaf", 2, 16, log=True),
        "training": {"recorded_share": trial.suggest_float("recorded_share", 0.1, 1.0)},
    },
}


def sweep(study: optuna.Study, model: str, folder: Folder, trials: int) -> Iterator[Part]:
    """Each trial's errors on held-out lines, their geometric mean (NaN where it was given up) and what was tried.

    folder: calibration slides. A trial keeps its `settings` and `errors` as user attributes.

    Raises:
        InputError: the model cannot be fitted, or there are too few lines to hold some out.
    """
    chosen = model_named(model)
    atlas = design_for(chosen, folder, None)

    def objective(trial: optuna.Trial) -> float:
        trial.set_user_attr("settings", SETTINGS[model](trial))

        def judge(thirds: int, summary: dict[str, float]) -> None:
            trial.report(errors_of(summary)["overall"], thirds)
            if trial.should_prune():
                raise optuna.TrialPruned

        config = changed(chosen.config(), trial.user_attrs["settings"], "sweep")
        fitted = fit_model(chosen, folder, config, Given(atlas=atlas, calibrate=kept_map, judge=judge))
        if "heldout_offset_mm" not in fitted.summary:
            raise InputError(f"{folder.root}: too few lines to hold some out; record more calibration slides")
        trial.set_user_attr("errors", errors_of(fitted.summary))
        return trial.user_attrs["errors"]["overall"]

    ended: list[optuna.trial.FrozenTrial] = []
    for _ in range(trials):
        study.optimize(objective, n_trials=1, callbacks=[lambda _, trial: ended.append(trial)])
        errors = ended[-1].user_attrs.get("errors", {"overall": np.nan})
        yield f"trial {ended[-1].number}", {**errors, **ended[-1].params}


def errors_of(summary: dict[str, float]) -> dict[str, float]:
    """Mean errors of a fit at the whole stroke on held-out lines: direction deg, speed %, distance mm; and `overall`,
    their geometric mean: an improvement of a tenth counts alike in each."""
    if "heldout_log_speed" in summary:
        summary = summary | {"heldout_speed_percent": 100.0 * summary["heldout_log_speed"]}
    errors = {name: summary[f"heldout_{name}"] for name in ("direction_deg", "speed_percent", "offset_mm")}
    return {**errors, "overall": float(np.exp(np.mean(np.log(np.maximum(list(errors.values()), 1e-9)))))}


def search(given: argparse.Namespace) -> Iterator[Part]:
    """`sweep` with these options; then the best settings."""
    folder = recordings_to_learn_from(without_base_motion(read_folder(given.recordings)))
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    # Trials of other recordings are another study.
    name, pruner = f"{given.model}-{data_hashes(folder)['slides'][:12]}", PRUNERS[given.pruner]
    study = optuna.create_study(study_name=name, storage=given.storage, pruner=pruner, load_if_exists=True)
    # A sampler with the same seed would draw the same first trials again.
    study.sampler = optuna.samplers.TPESampler(seed=len(study.trials))
    yield from sweep(study, given.model, folder, given.trials)
    best = tomli_w.dumps(study.best_trial.user_attrs["settings"])
    print(best, end="")
    given.out.write_text(best, encoding="utf-8")


def main(argv: Sequence[str] | None = None) -> int:
    words = parser("sweep", __doc__)
    recordings(words, "its calibration splits are used")
    words.add_argument("--model", choices=SETTINGS, default="cnn", help="default: %(default)s")
    count(words, "--trials", 20)
    words.add_argument("--storage", metavar="URL", help="sqlite:///sweep.db, say (default: in memory)")
    words.add_argument("--pruner", choices=PRUNERS, default="median", help="default: %(default)s")
    words.add_argument("--out", type=Path, required=True, metavar="best.toml", help="where the best go")
    return run(words, lambda given: search(given), argv)


if __name__ == "__main__":
    sys.exit(main())

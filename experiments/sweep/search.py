"""A hyperparameter search: workers fit, this process alone keeps the journal and MLflow's runs.

The journal lies beside the sweep's file, and so does its report. Whatever stops the search, the next call of the same
sweep goes on: finished trials count, and those that were under way begin again. Hopeless ones are given up midway.
"""

import hashlib
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

import optuna
import tomli_w
from joblib.externals.loky import get_reusable_executor
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, Trial, TrialState

from experiments.provenance import data_tags
from experiments.sweep.pictures import pictures, report
from experiments.sweep.space import Sweep, read_sweep
from experiments.sweep.trial import overall, run_trial
from experiments.tracking.run import tracked
from experiments.train import design_for
from features.errors import InputError
from models.registry import model_named
from pipeline.atlas.atlas import Atlas, atlas_hash
from pipeline.progress import progress_bar
from pipeline.recordings.base_motion import without_base_motion
from pipeline.recordings.derived_labels import recordings_to_learn_from
from pipeline.recordings.folder import Folder, read_folder
from pipeline.staging import whole, writing
from pipeline.workers import cluster, end_with

# A user attribute of a trial: its errors by quantity; or why it has none.
ERRORS, FAULT = "errors", "fault"
ENDED = (TrialState.COMPLETE, TrialState.PRUNED)
# A user attribute of the study, once the trial of this number has its run.
LOGGED = "logged {}"


def sweep(config: Path, scheduler: str = "", store: str | None = None) -> str:
    """Searches until the budget is used up; the best settings as TOML for `train --config`.

    config: as in experiments/sweep/space.py. scheduler: as in `pipeline.workers.results`. store: as in
    `tracking.store.store_address`.

    Raises:
        InputError: what is read is not what it should be, another sweep uses the journal, or no trial succeeded.
    """
    plan = read_sweep(config)
    folder = recordings_to_learn_from(without_base_motion(read_folder(plan.recordings)))
    if scheduler:
        folder = folder.at_its_place()
    if not len(folder):
        raise InputError(f"{plan.recordings}: no labelled calibration slides to hold lines out of")
    design = design_for(model_named(plan.model), folder, plan.atlas)
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    hashes = data_tags(folder)
    hashes |= {} if design is None else {"atlas": atlas_hash(design)}
    with _journal(config.with_suffix(".journal")) as journal:
        study = _study(plan, hashes, journal)
        tags = {"sweep": study.study_name, **hashes}
        with tracked("sweep", study.study_name, plan.as_table(), config, tags=tags, store=store) as run:
            for trial in _trials(plan, study, folder, design, scheduler):
                _track(plan, trial, tags, config, store)
                study.set_user_attr(LOGGED.format(trial.number), True)
            best = _best(config, study)
            text = tomli_w.dumps(plan.table(best.params))
            run.text(text, "best.toml")
            run.metrics(_figures(best))
            for name, picture in pictures(study).items():
                run.text(picture, f"figures/{name}.svg")
            page = report(study, best, text)
            run.text(page, "report.html")
            _write(config.with_suffix(".html"), page)
    found = ", ".join(f"{name} {error:.3g}" for name, error in best.user_attrs[ERRORS].items())
    count = len(study.get_trials(states=ENDED))
    print(f"softslide sweep: best of {count} is trial {best.number}: {found}", file=sys.stderr)
    print(f"softslide sweep: wrote {config.with_suffix('.html')}", file=sys.stderr)
    return text


def _best(config: Path, study: optuna.Study) -> FrozenTrial:
    """The trial with the least errors.

    Raises:
        InputError: none succeeded.
    """
    if not study.get_trials(states=[TrialState.COMPLETE]):
        faults = [t.user_attrs[FAULT] for t in study.trials if FAULT in t.user_attrs]
        raise InputError(f"{config}: no trial succeeded ({faults[0] if faults else 'none began'})")
    return study.best_trial


def _write(path: Path, text: str) -> None:
    """Writes the file whole or not at all.

    Raises:
        InputError: it cannot be written.
    """
    with writing(path, "move the sweep's file"), whole(path) as scratch:
        scratch.write_text(text, encoding="utf-8")


@contextmanager
def _journal(path: Path) -> Iterator[Path]:
    """The journal for this process alone, without an incomplete last line that a killed process may have left.

    Raises:
        InputError: another process has it, or it cannot be written.
    """
    with writing(path, "move the sweep's file"):
        file = path.open("ab+")
    with file:
        try:
            # Where there are such locks: Windows has none.
            with suppress(ImportError):
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{path}: another sweep is at work on it; wait for it") from None
        file.seek(0)
        file.truncate(file.read().rfind(b"\n") + 1)
        yield path


def _study(plan: Sweep, hashes: Mapping[str, str], journal: Path) -> optuna.Study:
    """The study of this search; trials that were interrupted are queued again."""
    what = [
        plan.model,
        plan.settings,
        {k: repr(d) for k, d in plan.space.items()},
        str(plan.atlas),
        dict(hashes),
    ]
    name = f"{plan.model}-{hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:12]}"
    storage = JournalStorage(JournalFileBackend(str(journal)))
    study = optuna.create_study(storage=storage, study_name=name, load_if_exists=True)
    # A sampler with the same seed would draw the same first trials again.
    study.sampler = optuna.samplers.TPESampler(seed=len(study.trials))
    for trial in study.get_trials(states=[TrialState.RUNNING]):
        study.tell(trial.number, state=TrialState.FAIL)
        study.enqueue_trial(trial.params)
    return study


def _trials(
    plan: Sweep, study: optuna.Study, folder: Folder, design: Atlas | None, scheduler: str
) -> Iterator[FrozenTrial]:
    """Asks for trials, runs them on workers, and reports their results; yields each trial as it ends.

    First those that ended in an earlier call which was stopped before they were logged.
    """
    until = time.monotonic() + plan.budget.seconds
    earlier = [t for t in study.trials if t.state in ENDED or FAULT in t.user_attrs]
    ended = len(earlier)
    if ended:
        print(f"softslide sweep: {ended} trials of an earlier call", file=sys.stderr)
    yield from (t for t in earlier if LOGGED.format(t.number) not in study.user_attrs)
    running: dict[Future, Trial] = {}
    bar = progress_bar(plan.model, "trial", total=plan.budget.trials, done=ended)
    with bar, _pool(plan.budget.workers, scheduler) as pool:
        while True:
            while (
                len(running) < plan.budget.workers
                and ended + len(running) < plan.budget.trials
                and time.monotonic() < until
            ):
                trial = study.ask(plan.space)
                try:
                    settings = plan.configuration(trial.params)
                except InputError as error:
                    yield _fail(study, trial, error)
                    ended += 1
                    bar.update()
                    continue
                against = study.get_trials(states=[TrialState.COMPLETE]) if plan.budget.prune else []
                running[pool.submit(run_trial, plan.model, folder, settings, design, against)] = trial
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield _tell(study, running.pop(future), future)
                ended += 1
                bar.update()


@contextmanager
def _pool(workers: int, scheduler: str) -> Iterator[Executor]:
    """Processes of this computer, which end with this one, or those of a Dask cluster."""
    if scheduler:
        with cluster(scheduler) as client:
            yield client.get_executor(pure=False)
        return
    pool = get_reusable_executor(
        workers,
        env={"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
        initializer=end_with,
        initargs=(os.getpid(),),
    )
    try:
        yield pool
    finally:
        pool.shutdown(kill_workers=True)


def _tell(study: optuna.Study, trial: Trial, future: Future) -> FrozenTrial:
    try:
        outcome = future.result()
    except (InputError, ValueError, FloatingPointError) as error:
        return _fail(study, trial, error)
    for thirds, so_far in outcome.so_far.items():
        trial.report(so_far, thirds)
    if not outcome.errors:
        return study.tell(trial, state=TrialState.PRUNED)
    trial.set_user_attr(ERRORS, outcome.errors)
    return study.tell(trial, overall(outcome.errors))


def _fail(study: optuna.Study, trial: Trial, error: Exception) -> FrozenTrial:
    trial.set_user_attr(FAULT, str(error))
    return study.tell(trial, state=TrialState.FAIL)


def _track(plan: Sweep, trial: FrozenTrial, tags: Mapping[str, str], config: Path, store: str | None) -> None:
    """One run a trial, a child of the sweep's."""
    try:
        settings = asdict(plan.configuration(trial.params))
    except InputError:
        settings = plan.table(trial.params)
    configuration = {**plan.as_table(), "settings": settings}
    if FAULT in trial.user_attrs:
        tags = {**tags, FAULT: trial.user_attrs[FAULT]}
    if trial.state is TrialState.PRUNED:
        tags = {**tags, "given_up": f"after {max(trial.intermediate_values)} of 3 parts of the training"}
    parent = {"sweep": tags["sweep"], "command": "sweep"}
    name = f"{tags['sweep']} trial {trial.number}"
    with tracked("trial", name, configuration, config, tags=tags, parent=parent, store=store) as run:
        run.by_step("heldout_overall_so_far", trial.intermediate_values)
        if ERRORS in trial.user_attrs:
            run.metrics(_figures(trial))


def _figures(trial: FrozenTrial) -> dict[str, float]:
    errors = {f"heldout_{name}": error for name, error in trial.user_attrs[ERRORS].items()}
    return {**errors, "heldout_overall": trial.value or 0.0}

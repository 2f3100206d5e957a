"""One training: recordings in, a bundle out, a run logged that suffices to repeat it."""

import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import onnx
import pandas as pd

from softslide.experiments.configuration import configured
from softslide.experiments.data_use import report_base, report_plan, report_use
from softslide.experiments.evaluation import figures
from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.readout import predictions
from softslide.experiments.evaluation.scoring import score, summary
from softslide.experiments.kept_map import kept_map
from softslide.experiments.pages.page import panels_page
from softslide.experiments.provenance import bundle_hash, code_revision, data_hashes, data_tags
from softslide.experiments.tracking import Run, last_duration_s, tracked
from softslide.features.card import read_card
from softslide.features.errors import InputError
from softslide.models.export.bundle import read_graph, write_bundle
from softslide.models.fitted_model import FittedModel, Given, Model
from softslide.models.registry import fit_model, model_named
from softslide.pipeline.atlas.atlas import Atlas, atlas_hash
from softslide.pipeline.atlas.library import atlas_at_hand, atlas_of
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.derived_labels import (
    LINE,
    recordings_to_learn_from,
    why_not_labelled,
    with_derived_labels,
)
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.recordings.pooled import read_folders
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.pipeline.staging import check_replaceable
from softslide.serve.localizer import Localizer

BUNDLE_FILES = ("model.onnx", "model.json")
# Share of the held-out slides whose direction is lost (models/cnn/fit.py) above which `train` says so.
LOST = 0.1


@dataclass(frozen=True)
class Training:
    """What `train` made: the bundle, its fit, and where its run was logged."""

    bundle: Path
    fitted: FittedModel
    run: Run


def train(
    recordings: str | Path | Sequence[str | Path],
    out: str | Path,
    model: str = "cnn",
    *,
    weight: Sequence[float] = (),
    atlas: str | Path | None = None,
    init: str | Path | None = None,
    config: str | Path | None = None,
    change: Callable[[Any], Any] = lambda default: default,
    design_alone: bool = False,
    register: bool = False,
    fresh: bool = False,
    store: str | None = None,
    track: bool = True,
) -> Training:
    """Fits one model to the splits that begin with `calibration` or `train`, and exports it.

    recordings: a folder, or several of one sensor, which are pooled. weight: how much each folder's count in the
    response map; none: all alike.
    atlas: what the sensor's design says, from `softslide simulate`; without one, and without labelled
    recordings, the default sensor's. init: a bundle to start from (warm start). config: TOML over the model's defaults,
    or `configuration.json` of a run; change: applied to the defaults before it. design_alone: uses no recording.
    register: whether to register the bundle. fresh: calibrates the response map even where an earlier training of the
    same recordings kept it (experiments/kept_map.py). store: as in `tracking.store_address`. track: whether a run
    is logged.

    Raises:
        InputError: what is read is not as docs/format.md says, there is nothing to train on, or no recording that has
            labels can be used and the design alone was not asked for.
        ParityError: the exported graph and the original disagree; nothing is written.
    """
    out = Path(out)
    atlas, init, config = (None if path is None else Path(path) for path in (atlas, init, config))
    chosen = model_named(model)
    roots = [Path(recordings)] if isinstance(recordings, str | Path) else [Path(root) for root in recordings]
    if weight and not chosen.uses_design:
        raise InputError(
            f"not for {model}: it weighs slides in the response map, which {model} has not", "weight"
        )
    whole = without_base_motion(read_folders(roots, weight))
    folder = to_learn_from(whole, chosen, design_alone)
    settings = configured(change(chosen.config()), config, model)
    if init is not None:
        Localizer.load(init)  # sees that it is whole
    start = None if init is None else read_graph(init)
    check_replaceable(out, BUNDLE_FILES)
    design = design_for(chosen, folder, atlas)
    configuration = {
        "model": model,
        "recordings": str(roots[0]) if len(roots) == 1 else [str(root) for root in roots],
        "atlas": None if atlas is None else str(atlas),
        "init": None if init is None else str(init),
        "design_alone": design_alone,
        "weights": list(weight),
        "settings": asdict(settings),
    }
    starts_from = {} if design is None else {"atlas": atlas_hash(design)}
    if init is not None:
        starts_from["init"] = read_card(init / "model.json").graph_sha256
    data = data_hashes(folder)
    provenance = {"configuration": configuration, "data": data, "code": code_revision(), **starts_from}
    report_base(whole)
    last_s = last_duration_s({"command": "train", "model": model}, store) if track else None
    report_plan(model, whole.select(*CALIBRATION), folder, design is not None, last_s)
    run_name = f"{model} on {folder.sensor.name}"
    tags = data_tags(data) | {"model": model} | starts_from
    logged = (
        tracked("train", run_name, configuration, tags=tags, store=store) if track else nullcontext(Run())
    )
    with logged as run:
        if len(folder) and track:
            run.data(folder, "training")
        fitted, losses = _fit(chosen, folder, settings, design, start, fresh)
        _warn_if_lost(fitted)
        if not design_alone:
            report_use(whole.select(*CALIBRATION), folder, fitted, chosen.several_heights)
        windows = fitted.windows or labelled_windows(folder, fitted.conditioning)
        parity = write_bundle(fitted, folder.sensor, windows, provenance, out, folder.base_motion)
        run.files(out, "bundle")
        run.tags({"bundle": bundle_hash(out)})
        run.losses(losses)
        run.metrics({**fitted.summary, "parity": parity})
        if len(folder) and track:
            _log_fit(run, out, folder)
        if register:
            run.register({"bundle": bundle_hash(out)})
    return Training(out, fitted, run)


def to_learn_from(whole: Folder, model: Model, design_alone: bool) -> Folder:
    """The recordings to learn from: of the splits CALIBRATION, those whose line is known.

    A model that can learn from several heights of the skin takes those too that are not at the pressure of most.

    Raises:
        InputError: some have labels and none can be used.
    """
    chosen = whole.select(*CALIBRATION)
    if design_alone:
        return replace(chosen, manifest=chosen.manifest.iloc[:0])
    folder = recordings_to_learn_from(chosen, model.several_heights)
    some = chosen.manifest[list(LINE)].notna().any(axis=1)
    if not len(folder) and some.any():
        name, why = next(iter(why_not_labelled(with_derived_labels(chosen)).items()))
        raise InputError(
            f"{chosen.root}: none of {int(some.sum())} labelled recordings can be used ({name}: {why}); "
            "add the labels, or train from the design alone"
        )
    return folder


def _fit(
    model: Model,
    folder: Folder,
    settings: Any,
    design: Atlas | None,
    start: onnx.ModelProto | None,
    fresh: bool,
) -> tuple[FittedModel, dict[int, float]]:
    """The fitted model and its loss by step, with a bar for who watches: the map's calibration, then the steps."""
    losses: dict[int, float] = {}
    steps = settings.training.steps if model.design_suffices else None
    stage = f"fitting {model.name}" if steps is None else "calibrating the response map"
    with progress_bar(stage, "step", total=steps) as bar:

        def progress(step: int, loss: float) -> None:
            if not losses:
                # The time left is that of the steps alone.
                bar.reset(steps)
                bar.set_description("training the network")
            losses[step] = loss
            bar.set_postfix(loss=f"{loss:.3f}", refresh=False)
            bar.update(step - bar.n)

        def taken(place: Path) -> None:
            bar.write(f"took the response map that an earlier training kept ({place})", file=sys.stderr)

        given = Given(design, start, partial(kept_map, fresh=fresh, taken=taken), progress)
        return fit_model(model, folder, settings, given), losses


def _warn_if_lost(fitted: FittedModel) -> None:
    """Warns where no estimate will be valid, or too many held-out slides have one that is no better than chance."""
    if fitted.validity.misfit == 0.0:
        print(
            f"too few slides to know what is not a slide: no estimate of this {fitted.name} will be valid; record more "
            "lines, or use cnn",
            file=sys.stderr,
        )
    if (lost := fitted.summary.get("heldout_lost", 0.0)) > LOST:
        print(
            f"the model is lost on {lost:.0%} of the slides held out of its fit and abstains where it sees that; "
            "train for more steps ([training] in the configuration), or run 'softslide check' on the recordings",
            file=sys.stderr,
        )


def design_for(model: Model, folder: Folder, atlas: Path | None) -> Atlas | None:
    """The atlas that the model is to use: solved now only for one that learns from the design alone.

    Raises:
        InputError: the atlas named is not an atlas, or of another design.
    """
    if model.design_suffices:
        return design_of(folder, atlas)
    return atlas_at_hand(folder.sensor, atlas) if model.uses_design or atlas is not None else None


def design_of(folder: Folder, atlas: Path | None) -> Atlas | None:
    """The atlas of the sensor's design; None without one, where there are recordings to learn from.

    Raises:
        InputError: the atlas named is not an atlas, or of another design; or nothing else is there to learn from.
    """
    try:
        return atlas_of(folder.sensor, atlas)
    except InputError as error:
        if atlas is not None or not len(folder):
            raise
        print(f"no atlas ({error}); from recordings alone", file=sys.stderr)
        return None


def _log_fit(run: Run, bundle: Path, folder: Folder) -> None:
    """Errors of the exported bundle on the recordings that it was fitted to; `evaluate` scores it on others."""
    # A second process takes as long to start as some fifty recordings to read.
    archive = Archive(jobs=min(2, 1 + len(folder) // 50))
    table = pd.concat(predictions(bundle, folder, archive), ignore_index=True)
    scored = score(table, folder.manifest, folder.sensor)
    end = scored[scored["stroke_fraction"] == 1.0]
    for name, error in summary(end).items():
        if isinstance(error, dict) and "mean" in error:
            run.metrics({f"fitted_{name}_{kind}": error[kind] for kind in ("mean", "p95", "max")})
    groups = [
        ("As the stroke goes on", figures.along_the_stroke(scored)),
        ("Recording by recording", figures.recording_by_recording(end, ())),
    ]
    run.text(panels_page("errors on the recordings fitted", (), groups), "figures/fitted.html")

"""One training: recordings in, a bundle out, an MLflow run kept."""

import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import onnx
import pandas as pd
from tqdm import tqdm

from experiments import tracking
from experiments.configuration import configured
from experiments.evaluation import figures
from experiments.evaluation.readout import predictions
from experiments.evaluation.scoring import score, summary
from features.errors import InputError
from models.export.bundle import read_graph, write_bundle
from models.fitted_model import FittedModel
from models.registry import default_config, fit_model
from pipeline.atlas.atlas import Atlas
from pipeline.atlas.library import atlas_of
from pipeline.recordings.folder import Folder, read_folder
from pipeline.recordings.windows import labelled_windows
from pipeline.staging import check_replaceable
from serve.localizer import Localizer

BUNDLE_FILES = ("model.onnx", "model.json")
LOST = 0.1  # share of held-out slides


@dataclass(frozen=True)
class Training:
    """What `train` made: the bundle, its fit, and where the run is kept."""

    bundle: Path
    fitted: FittedModel
    run: tracking.Run
    logged_model: str


def train(
    recordings: Path,
    out: Path,
    model: str = "cnn",
    *,
    atlas: Path | None = None,
    init: Path | None = None,
    config: Path | None = None,
    change: Callable[[Any], Any] = lambda default: default,
    store: str | None = None,
) -> Training:
    """Fits one model to the splits that begin with `calibration` or `train`, and exports it.

    atlas: what the sensor's design says, from `softslide simulate`; without one, and without labelled
    recordings, the default sensor's. init: a bundle to go on from. config: TOML over the model's defaults;
    change: applied to the defaults before it. store: as in `tracking.tracked`.

    Raises:
        InputError: what is read is not what the contract says, or there is nothing to train on.
        ParityError: the exported graph and the original disagree; nothing is written.
    """
    whole = read_folder(recordings)
    folder = whole.select("calibration", "train").labelled()
    settings = configured(change(default_config(model)), config)
    start = None if init is None else _graph_to_go_on_from(init)
    check_replaceable(out, BUNDLE_FILES)
    design = design_of(folder, atlas) if model == "cnn" or atlas is not None else None
    configuration = {
        "model": model,
        "recordings": str(recordings),
        "atlas": None if atlas is None else str(atlas),
        "init": None if init is None else str(init),
        "settings": asdict(settings),
    }
    provenance: dict[str, Any] = {
        "configuration": configuration,
        "data": tracking.data_hashes(folder),
        "code": tracking.code_revision(),
    }
    tags = {f"data.{name}": digest for name, digest in provenance["data"].items()}
    with tracking.tracked(f"{model} on {folder.sensor.name}", configuration, tags, store) as run:
        if len(folder):
            run.data(folder, "training")
        losses: dict[int, float] = {}
        with tqdm(desc=f"fitting {model}", unit="step", disable=not sys.stderr.isatty()) as bar:

            def progress(step: int, loss: float) -> None:
                losses[step] = loss
                bar.set_postfix(loss=f"{loss:.3f}", refresh=False)
                bar.update(step - bar.n)

            fitted = fit_model(model, folder, settings, atlas=design, init=start, progress=progress)
        if (lost := fitted.summary.get("heldout_lost", 0.0)) > LOST:
            print(
                f"the model is lost on {lost:.0%} of the slides kept from it and abstains where it sees that; "
                "train for more steps ([training] in the configuration), or run 'softslide check' on the recordings",
                file=sys.stderr,
            )
        windows = fitted.windows or labelled_windows(folder, fitted.conditioning)
        difference = write_bundle(fitted, folder.sensor, windows, provenance, out)
        logged = run.model(out, model)
        run.losses(losses)
        run.metrics({**fitted.summary, "parity": difference}, logged)
        if len(folder):
            _log_fit(run, out, folder, logged)
    return Training(out, fitted, run, logged)


def _graph_to_go_on_from(bundle: Path) -> onnx.ModelProto:
    """The graph of a bundle that is whole.

    Raises:
        InputError: the bundle is missing or broken.
    """
    Localizer.load(bundle)
    return read_graph(bundle)


def design_of(folder: Folder, atlas: Path | None) -> Atlas | None:
    """The atlas of the sensor's design; None if it cannot be had and there are recordings to go on.

    Raises:
        InputError: the atlas named is none, or of another design; or nothing else is there to learn from.
    """
    try:
        return atlas_of(folder.sensor, atlas)
    except InputError as error:
        if atlas is not None or not len(folder):
            raise
        print(f"no atlas ({error}); from recordings alone", file=sys.stderr)
        return None


def _log_fit(run: tracking.Run, bundle: Path, folder: Folder, logged: str) -> None:
    """What the exported bundle makes of the recordings behind it; how it does on others, `evaluate` says."""
    table = pd.concat(predictions(bundle, folder), ignore_index=True)
    scored = score(table, folder.manifest, folder.sensor)
    for name, error in summary(scored[scored["stroke_fraction"] == 1.0]).items():
        if isinstance(error, dict) and "mean" in error:
            run.metrics({f"fitted_{name}_{kind}": error[kind] for kind in ("mean", "p95", "max")}, logged)
    run.text(figures.along_the_stroke(scored), "figures/fitted_along_the_stroke.svg")
    run.text(figures.recording_by_recording(scored), "figures/fitted_recording_by_recording.svg")

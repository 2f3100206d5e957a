"""`softslide compare`: models fitted to the same calibration slides, or bundles as they are, on the same test slides.

Writes comparison.html, comparison.csv and paired.csv; bundles lie in OUT, below a folder for each folder of recordings.
"""

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from softslide.experiments.comparison.inversion import invert
from softslide.experiments.comparison.page import section
from softslide.experiments.comparison.paired import paired
from softslide.experiments.derived_labels import derived
from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.readout import predictions
from softslide.experiments.evaluation.scoring import INTERVALS, WORDS, score, summary
from softslide.experiments.pages.page import render
from softslide.experiments.train import train
from softslide.features.card import read_card
from softslide.features.errors import InputError
from softslide.features.window import Window
from softslide.models.registry import MODELS as REGISTERED
from softslide.pipeline.recordings.base_motion import without_base_motion
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.recordings.learned import CALIBRATION, learned_lines
from softslide.pipeline.recordings.windows import LabelledWindows, labelled_windows
from softslide.pipeline.staging import writing
from softslide.serve.localizer import Localizer

MODELS = (*REGISTERED, "inversion")
# The model that the others are held against, where it is among them; else the first.
REFERENCE = "cnn"
TEMPLATE = Path(__file__).parent / "comparison.html.j2"
TIMED = 20  # windows


@dataclass
class Findings:
    """Of one folder. scored: by model, of `scoring.score`. window_ms: median time of a window by model. left_out:
    models, and why. along: scored recordings along calibration lines, which are not paired."""

    origin: str
    along: pd.Index
    scored: dict[str, pd.DataFrame] = field(default_factory=dict)
    window_ms: dict[str, float] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)

    def pairs(self) -> pd.DataFrame:
        """Of `paired.paired`, of slides along new lines."""
        new = {model: table[~table["recording"].isin(self.along)] for model, table in self.scored.items()}
        return paired(new, REFERENCE if REFERENCE in new else next(iter(new)))


def compare(
    recordings: str | Path | Sequence[str | Path],
    out: str | Path,
    models: Sequence[str] = MODELS,
    jobs: int = 1,
) -> pd.DataFrame:
    """Fits, reads out and scores every model on every folder, and writes tables and a page into `out`; the errors.

    models: some of MODELS, or folders of bundles. jobs: recordings that a bundle reads at a time.

    Raises:
        InputError: an unknown model, a folder without the slides that are needed, two of the same name, or no model
        that suits a folder.
    """
    for name in models:
        if name not in MODELS and not (Path(name) / "model.json").is_file():
            known = ", ".join(MODELS)
            raise InputError(
                f"no model '{name}', nor a bundle there; name some of {known}, or folders of bundles"
            )
    out, given = Path(out), [recordings] if isinstance(recordings, str | Path) else recordings
    places = {Path(folder).resolve().name: Path(folder) for folder in given}
    _distinct([label(name) for name in models], "models")
    _distinct([Path(folder).resolve().name for folder in given], "folders")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    # Read before any work, so that bad input is found at once. At these sizes more threads are slower.
    folders = {name: _folders(place, models) for name, place in places.items()}
    torch.set_num_threads(1)
    found = {name: compare_on(*folders[name], models, out / name, jobs) for name in places}
    rows = [{"folder": name} | row for name, findings in found.items() for row in error_rows(findings)]
    pairs = {name: findings.pairs() for name, findings in found.items()}
    tables = {"comparison": pd.DataFrame(rows), "paired": pd.concat(pairs, names=["folder"]).reset_index(0)}
    for name, table in tables.items():
        table.to_csv(out / f"{name}.csv", index=False, float_format="%.6g", lineterminator="\n")
    sections = [vars(of) | section(name, of.scored, pairs[name]) for name, of in found.items()]
    (out / "comparison.html").write_text(render(TEMPLATE, sections=sections), encoding="utf-8")
    return tables["comparison"]


def label(model: str) -> str:
    """What one of MODELS, or a bundle by its folder, is called in tables."""
    return model if model in MODELS else Path(model).resolve().name


def _distinct(found: Sequence[str], what: str) -> None:
    if twice := [name for name in found if found.count(name) > 1]:
        raise InputError(f"{twice[0]}: two {what} of this name, which results go by; rename one")


def _folders(place: Path, models: Sequence[str]) -> tuple[Folder, Folder]:
    """The folder with all its recordings, and with those that are scored."""
    folder = without_base_motion(derived(read_folder(place)))
    for splits in (("test",), *((CALIBRATION,) if set(models) & set(MODELS) else ())):
        if not len(folder.select(*splits).labelled()):
            raise InputError(
                f"{place / 'manifest.csv'}: no labelled slide of a split {' or '.join(splits)}*; add some"
            )
    return folder, folder.select("test").labelled()


def compare_on(folder: Folder, test: Folder, models: Sequence[str], out: Path, jobs: int = 1) -> Findings:
    """One folder's findings. A model that does not suit the sensor is left out.

    Raises:
        InputError: no model suits it.
    """
    lines = learned_lines(folder.manifest)
    found = Findings(folder.sensor.origin, lines.index[lines != ""].intersection(test.manifest.index))
    for model in models:
        called = label(model)
        print(f"{out.name}: {called}", file=sys.stderr)
        try:
            table, window_ms = _read_out(model, folder, test, out, jobs)
        except InputError as error:
            print(f"{out.name}: {called} is left out: {error}", file=sys.stderr)
            found.left_out[called] = str(error)
            continue
        found.scored[called] = score(table, test.manifest, test.sensor)
        found.window_ms[called] = window_ms
    if not found.scored:
        raise InputError(f"{folder.root}: {next(iter(found.left_out.values()))}")
    return found


def _read_out(model: str, folder: Folder, test: Folder, out: Path, jobs: int) -> tuple[pd.DataFrame, float]:
    """A model's rows of `predictions.csv`, fitted first if it is one of MODELS, and the median ms of a window."""
    if model == "inversion":
        table, predict, conditioning = invert(folder.select(*CALIBRATION).labelled(), test)
        return table, _median_ms(predict, labelled_windows(test, conditioning))
    bundle = Path(model)
    if model in MODELS:
        bundle = train(folder.root, out / model / "bundle", model, track=False).bundle
    card, recorded = read_card(bundle / "model.json"), replace(test, base_motion=None)
    table = pd.concat(predictions(bundle, recorded, Archive(jobs)), ignore_index=True)
    windows = labelled_windows(replace(test, base_motion=card.base), card.conditioning)
    return table, _median_ms(_one_window(bundle), windows)


def _one_window(bundle: Path) -> Callable[[np.ndarray, np.ndarray], object]:
    localizer = Localizer.load(bundle)
    return lambda volts, elapsed_s: localizer.infer(localizer.inputs(Window(volts[0], float(elapsed_s[0]))))


def _median_ms(one: Callable[[np.ndarray, np.ndarray], object], windows: LabelledWindows) -> float:
    """Of single windows, volts (1, C, 64) V and elapsed_s (1,) s."""
    times_s = []
    for n in np.linspace(0, len(windows) - 1, TIMED).astype(int):
        begun = time.perf_counter()
        one(windows.volts[n : n + 1], windows.elapsed_s[n : n + 1])
        times_s.append(time.perf_counter() - begun)
    return 1e3 * float(np.median(times_s))


def error_rows(found: Findings) -> list[dict[str, Any]]:
    """The rows of comparison.csv: for each split, model and stroke fraction how many there are, the share that is
    valid, errors of valid estimates and the share of their intervals that hold; NaN where there is no estimate."""
    rows = []
    for model, scored in found.scored.items():
        for (split, fraction), part in scored.groupby(["split", "stroke_fraction"]):
            of = summary(part)
            row = {"split": split, "model": model, "stroke_fraction": fraction, "n": len(part)}
            row["valid_share"] = of["valid_share"]
            for quantity in WORDS:
                name, unit = quantity.split("_")
                row |= {f"{name}_{kind}_{unit}": of[quantity].get(kind, np.nan) for kind in ("mean", "max")}
            row["depth_mean_mm"] = (
                (part["depth_mm"] - part["true_depth_mm"]).abs()[part["valid"].astype(bool)].mean()
            )
            for column in INTERVALS:
                row[f"{column.split('_')[0]}_coverage"] = of[f"{column}_coverage"].get("share", np.nan)
            rows.append(row | {"window_ms": found.window_ms[model]})
    return rows

"""Every baseline in one table: fitted to the same calibration slides, scored on the same test slides.

Writes comparison.html, comparison.md, comparison.csv, paired.csv, times.csv, efficiency.csv and figures. Below OUT each
folder of recordings has its bundles and readouts; what an earlier run has left there, of the same configuration and
data, is taken up again.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from experiments.comparison import figures as comparison_figures
from experiments.comparison.page import TEMPLATE, section
from experiments.comparison.paired import COLUMNS as PAIRED
from experiments.comparison.paired import paired
from experiments.comparison.peers import MODELS, Study, kept, label, map_settings, read_out
from experiments.comparison.table import error_rows, markdown
from experiments.evaluation import efficiency
from experiments.evaluation.scoring import score
from experiments.pages.page import render
from experiments.tracking.study import tracked_study
from features.errors import InputError
from pipeline.recordings.derived_labels import with_derived_labels
from pipeline.recordings.folder import read_folder
from pipeline.recordings.taught import taught_lines
from pipeline.staging import writing

# The model that the others are held against, where it is among them; else the first.
REFERENCE = "cnn"


@dataclass
class Findings:
    """One folder's rows of comparison.csv, times.csv, efficiency.csv and paired.csv, and the models left out, with the
    reason.

    origin: of its sensor.toml. taught: number of scored recordings along calibration lines, which are not paired.
    """

    origin: str
    taught: int = 0
    paired: pd.DataFrame = field(default_factory=lambda: pd.DataFrame(columns=list(PAIRED)))
    errors: list[dict[str, Any]] = field(default_factory=list)
    times: list[dict[str, Any]] = field(default_factory=list)
    ratios: list[pd.DataFrame] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)


def compare(recordings: Sequence[Path], out: Path, models: Sequence[str] = MODELS, jobs: int = 1) -> None:
    """Fits, reads out and scores every model on every folder, and writes tables and figures into `out`.

    models: some of MODELS, or folders of bundles. A run is logged, with one below it for each model on each folder; the
    trainings' own are in `out`.

    Raises:
        InputError: an unknown model, a folder that is none, two of the same name, or no model that suits a folder.
    """
    fitted = [name for name in models if name in MODELS]
    given = [name for name in models if name not in MODELS]
    if unknown := [name for name in given if not (Path(name) / "model.json").is_file()]:
        raise InputError(
            f"no model '{unknown[0]}', nor a bundle there; name some of {', '.join(MODELS)}, or folders of bundles"
        )
    called = [label(name) for name in models]
    if twice := [name for name in called if called.count(name) > 1]:
        raise InputError(f"{twice[0]}: two models of this name, which results go by; rename one", "models")
    names = [folder.resolve().name for folder in recordings]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"{twice[0]}: two folders of this name, which results go by; rename one")
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    # At these sizes more threads are slower.
    torch.set_num_threads(1)
    store = f"sqlite:///{out / 'mlflow.db'}"
    studies = [Study(folder, out / name, store, jobs) for folder, name in zip(recordings, names, strict=True)]
    for study in studies:
        # Both are read before any work, so that bad input is found at once.
        _ = study.scored, study.taught if fitted else None
    configuration = {"recordings": [str(folder) for folder in recordings], "models": list(models)}
    with tracked_study("compare", f"compare on {', '.join(names)}", configuration, out) as (run, part):
        found = {study.place.name: compare_on(study, models) for study in studies}
        _write(found, out)
        for name, findings in found.items():
            for row in findings.times:
                figures = _at_the_end(findings, row["model"]) | {"window_ms": row["window_ms"]}
                part(f"{row['model']} on {name}", {"folder": name, "model": row["model"]}, figures)
        for path in sorted(out.iterdir()):
            if path.suffix in (".md", ".csv", ".svg", ".html"):
                run.text(path.read_text(encoding="utf-8"), f"comparison/{path.name}")


def _at_the_end(findings: Findings, model: str) -> dict[str, float]:
    """A model's figures at the end of the stroke, by split."""
    return {
        f"{row['split']}.{key}": value
        for row in findings.errors
        if row["model"] == model and row["stroke_fraction"] == 1.0
        for key, value in row.items()
        if isinstance(value, float) and key != "stroke_fraction"
    }


def compare_on(study: Study, models: Sequence[str]) -> Findings:
    """One folder's figures. A model that does not support the sensor is left out.

    Raises:
        InputError: no model suits it.
    """
    name, found, scored = study.place.name, Findings(study.scored.sensor.origin), {}
    for model in models:
        called = label(model)
        print(f"{name}: {called}", file=sys.stderr)
        try:
            readout = read_out(study, model)
        except InputError as error:
            print(f"{name}: {called} is left out: {error}", file=sys.stderr)
            found.left_out[called] = str(error)
            continue
        scored[called] = score(readout.table, study.scored.manifest, study.scored.sensor)
        head = {"folder": name, "model": called}
        found.errors += [head | row for row in error_rows(scored[called])]
        window_ms, one_node_ms = readout.window_ms, readout.one_node_ms
        times = {"window_ms": window_ms, "one_node_ms": one_node_ms, "ratio": window_ms / one_node_ms}
        found.times.append(head | times)
    if not scored:
        raise InputError(f"{study.recordings}: {next(iter(found.left_out.values()))}")
    lines = taught_lines(with_derived_labels(read_folder(study.recordings)).manifest)
    taught = lines.index[lines != ""].intersection(study.scored.manifest.index)
    found.taught = len(taught)
    unseen = {model: table[~table["recording"].isin(taught)] for model, table in scored.items()}
    found.paired = paired(unseen, REFERENCE if REFERENCE in scored else next(iter(scored)))
    found.paired.insert(0, "folder", name)
    # The bound is of the map that these calibration slides give, and of the models fitted to them.
    if against := [model for model in efficiency.COMPARED if model in scored and model in models]:
        bounds = _bounds(study)
        for model in against:
            ratios = efficiency.ratios(scored[model], bounds)
            ratios.insert(0, "folder", name)
            ratios.insert(1, "model", model)
            found.ratios.append(ratios)
    return found


def _bounds(study: Study) -> pd.DataFrame:
    def made() -> tuple[pd.DataFrame, dict[str, float]]:
        print(f"{study.place.name}: the Cramer-Rao bound", file=sys.stderr)
        return efficiency.bound(
            study.calibrated.response, study.calibrated.conditioning.block_s, study.windows
        ), {}

    return kept(study.place / "bound", {"map": map_settings(), **study.hashes}, made)[0]


def _write(found: dict[str, Findings], out: Path) -> None:
    errors = pd.DataFrame([row for findings in found.values() for row in findings.errors])
    # Model by model within each split, in the order in which they were named.
    errors["model"] = pd.Categorical(errors["model"], errors["model"].unique())
    errors = errors.sort_values(["folder", "split", "model", "stroke_fraction"])
    times = pd.DataFrame([row for findings in found.values() for row in findings.times])
    parts = [part for findings in found.values() for part in findings.ratios]
    ratios = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=["folder"])
    pairs = pd.concat([findings.paired for findings in found.values()], ignore_index=True)
    tables = {"comparison": errors, "times": times, "efficiency": ratios, "paired": pairs}
    for name, table in tables.items():
        table.to_csv(out / f"{name}.csv", index=False, float_format="%.6g", lineterminator="\n")
    text = []
    for folder, findings in found.items():
        e, t, r = (table[table["folder"] == folder] for table in (errors, times, ratios))
        text.append(markdown(findings.origin, e, t, r, findings.left_out))
        (out / f"errors-{folder}.svg").write_text(comparison_figures.errors(e), encoding="utf-8")
        if len(r):
            (out / f"efficiency-{folder}.svg").write_text(comparison_figures.efficiency(r), encoding="utf-8")
    (out / "comparison.md").write_text("\n".join(text), encoding="utf-8")
    sections = [
        section(folder, findings.origin, errors[errors["folder"] == folder], findings.paired, findings.taught)
        | {"left_out": findings.left_out}
        for folder, findings in found.items()
    ]
    (out / "comparison.html").write_text(render(TEMPLATE, sections=sections), encoding="utf-8")

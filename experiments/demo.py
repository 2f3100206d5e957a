"""The main job end to end on the sample that ships with the project, within minutes on two cores."""

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from softslide.experiments.evaluate import Evaluation, evaluate
from softslide.experiments.evaluation.scoring import QUANTITIES, WORDS
from softslide.experiments.pages.page import number, render
from softslide.experiments.train import train
from softslide.pipeline.recordings.folder import SAMPLE
from softslide.pipeline.staging import whole, writing

HERE = Path(__file__).parent
DEMO_MODELS = ("interpolation", "trees", "cnn")
# Enough for proposals that the refinement converges from; a full training takes four times as many.
DEMO_BUDGET = {"steps": 2500, "batch": 128, "average": 0.99}


def demo(out: str | Path) -> str:
    """Trains and evaluates each of DEMO_MODELS on the sample, below `out`; the table and the way to each result.

    The same is kept as a page, `summary.html`.

    Raises:
        InputError: `out` cannot be written.
    """
    out = Path(out)
    store = f"sqlite:///{out / 'mlflow.db'}"
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    evaluations = {}
    for model in DEMO_MODELS:
        print(f"softslide demo: training and evaluating {model}", file=sys.stderr)
        done = train(SAMPLE, out / model / "bundle", model, change=shortened, store=store)
        evaluations[model] = evaluate(done.bundle, SAMPLE, None, out / model / "evaluation", store=store)
    rows = _rows(evaluations)
    page = render(HERE / "pages" / "demo.html.j2", rows=rows, models=DEMO_MODELS, out=out)
    with whole(out / "summary.html") as scratch:
        scratch.write_text(page, encoding="utf-8")
    return "\n".join([*map(_line, rows), "", *_ways(out, store)])


def shortened(settings: Any) -> Any:
    """The demo's budget: fewer and smaller steps where a model trains in steps."""
    if not hasattr(getattr(settings, "training", None), "steps"):
        return settings
    return replace(settings, training=replace(settings.training, **DEMO_BUDGET))


def _rows(evaluations: dict[str, Evaluation]) -> list[tuple[str, list[str]]]:
    """The article's figures next to the largest error of each model, and each model's mean errors by split: a title and
    its cells, a note that has none."""
    columns = ["article", *evaluations]
    rows: list[tuple[str, list[str]]] = [
        ("Emulated bench recordings, never measured on hardware.", []),
        ("", []),
        ("largest error", columns),
    ]
    for verdicts in zip(*(e.verdicts for e in evaluations.values()), strict=True):
        bound = verdicts[0].bound
        unit = QUANTITIES[bound.quantity]
        cells = ["-" if v.met is None else f"{number(v.max)}{'' if v.met else ' !'}" for v in verdicts]
        rows.append((f"{bound.name}, {unit}", [f"< {bound.limit:g}", *cells]))
    note = "! beyond the article's bound, or without a valid estimate; - not tested: see the report"
    rows += [(note, []), ("", []), ("mean valid error at the end", columns)]
    for split in next(iter(evaluations.values())).metrics["splits"]:
        ends = [e.metrics["splits"][split]["1.0"] for e in evaluations.values()]
        for quantity, title in WORDS.items():
            cells = [number(end[quantity].get("mean")) for end in ends]
            rows.append((f"{split}: {title}, {QUANTITIES[quantity]}", ["", *cells]))
        rows.append((f"{split}: valid, %", ["", *(f"{100 * end['valid_share']:.0f}" for end in ends)]))
    return rows


def _line(row: tuple[str, list[str]]) -> str:
    title, cells = row
    return f"{title:<30}" + "".join(f"{cell:>15}" for cell in cells) if cells else title


def _ways(out: Path, store: str) -> list[str]:
    """Where each result lies, and the command that opens it."""
    here = os.path.relpath(Path(sys.executable).parent)
    slide = os.path.relpath(SAMPLE / "slides" / "a0120.parquet")
    return [
        f"summary  {out}/summary.html, with the way to each report",
        f"         {here}/python -m webbrowser -t {(out / 'summary.html').resolve().as_uri()}",
        f"bundles  {out}/*/bundle",
        f"         {here}/softslide predict --model {out}/cnn/bundle {slide}",
        f"runs     {store}",
        f"         {here}/mlflow ui --backend-store-uri {store}",
    ]

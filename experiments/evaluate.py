"""Batch evaluation of an exported bundle, through the device's own runtime, against the article's bounds.

It is logged as a run, a child of the bundle's training where the store has that.
"""

import json
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from softslide.experiments.derived_labels import derived
from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.bounds import WORDS, Verdict, check, read_bounds
from softslide.experiments.evaluation.efficiency import bounds_of, over_bound
from softslide.experiments.evaluation.readout import check_fits, open_localizer, predictions
from softslide.experiments.evaluation.report import write_report
from softslide.experiments.evaluation.scoring import (
    along_the_stroke,
    by_direction,
    by_distance,
    by_speed,
    coverage,
    score,
    summary,
)
from softslide.experiments.evaluation.tracks import Track, line, summaries, tracks, with_truth
from softslide.experiments.flattened import flattened
from softslide.experiments.provenance import bundle_hash, data_hashes, data_tags
from softslide.experiments.tracking import Run, tracked
from softslide.features.errors import InputError
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.derived_labels import with_derived_labels
from softslide.pipeline.recordings.folder import Folder, read_folder
from softslide.pipeline.recordings.learned import learned_depths_mm, learned_lines
from softslide.pipeline.staging import alone, staged


@dataclass(frozen=True)
class Evaluation:
    """What `evaluate` found: `metrics.json` as a dictionary, and each bound's verdict."""

    metrics: dict[str, Any]
    verdicts: tuple[Verdict, ...]

    @property
    def untested(self) -> int:
        """Number of bounds that nothing tests."""
        return sum(verdict.met is None for verdict in self.verdicts)

    def met(self, allow_untested: bool = False) -> bool:
        """Whether every bound is met. One that nothing tests is not met, unless `allow_untested`."""
        return all(verdict.met or (allow_untested and verdict.met is None) for verdict in self.verdicts)

    def to_frame(self) -> pd.DataFrame:
        """A row for each bound: what it limits, and the verdict; `met` is None where it is not tested."""
        rows = [
            {"name": v.bound.name, "quantity": v.bound.quantity, "limit": v.bound.limit}
            | {name: value for name, value in vars(v).items() if name != "bound"}
            for v in self.verdicts
        ]
        return pd.DataFrame(rows)

    def lines(self) -> list[str]:
        """Each bound's verdict, then each split's tracks, in a line."""
        live, whole = (self.metrics.get(key, {}) for key in ("tracks", "whole_contacts"))
        followed = [line(split, row) for split, row in live.items()]
        followed += [line(f"{split}, from whole contacts", row) for split, row in whole.items()]
        return [verdict.line() for verdict in self.verdicts] + followed


def evaluate(
    model: str | Path,
    recordings: str | Path,
    split: Sequence[str] | None,
    out: str | Path,
    jobs: int = 2,
    report: bool = True,
    *,
    scheduler: str = "",
    store: str | None = None,
    track: bool = True,
) -> Evaluation:
    """Writes `predictions.csv`, `metrics.json` and `report.html` to `out`, whole or not at all.

    split: those to score, by their full names; those that begin with `test` if None. jobs, scheduler:
    as in `pipeline.workers.results`. report: whether to draw one. store: as in `tracking.store_address`. track:
    whether a run is logged. A call that was killed goes on where it stopped.

    Raises:
        InputError: the bundle, the folder or a recording is not what the contract says, or no such split.
    """
    bundle, recordings, out = Path(model), Path(recordings), Path(out)
    whole = with_derived_labels(read_folder(recordings))
    folder = derived(to_score(whole, split))
    check_fits(open_localizer(bundle).card, folder)
    names = sorted(set(folder.manifest["split"]))
    configuration = {"bundle": str(bundle), "recordings": str(recordings), "splits": names}
    digest = bundle_hash(bundle)
    of_run: dict[str, Any] = {
        "tags": {"bundle": digest} | data_tags(data_hashes(folder)),
        "parent": {"bundle": digest, "command": "train"},
        "store": store,
    }
    run_name = f"{bundle.name} on {folder.sensor.name}"
    logged = tracked("evaluate", run_name, configuration, **of_run) if track else nullcontext(Run())
    with logged as run:
        with alone(work_of(out), out):
            archive = Archive(jobs, scheduler, work_of(out))
            result = _evaluated(bundle, whole, folder, out, archive, report)
        run.files(out, "evaluation")
        run.files(bundle, "bundle")
        run.metrics(_figures(result.metrics))
        run.tags({f"bound.{each.bound.name}": WORDS[each.met] for each in result.verdicts})
    return result


def _figures(metrics: dict[str, Any]) -> dict[str, float]:
    """Errors at the end of the stroke and shares, by split: the run's metrics."""
    found = {split: strokes["1.0"] for split, strokes in metrics["splits"].items() if "1.0" in strokes}
    for key, name in (("tracks", "tracked"), ("whole_contacts", "whole_contacts")):
        found |= {f"{split}.{name}": row for split, row in metrics.get(key, {}).items()}
    return {name: value for name, value in flattened(found).items() if isinstance(value, int | float)}


def _evaluated(
    bundle: Path, whole: Folder, folder: Folder, out: Path, archive: Archive, report: bool
) -> Evaluation:
    """Localizes, scores and writes. whole: the folder with all splits, of which calibration's lines are known."""
    with staged(out) as scratch:
        rows = predictions(bundle, folder, archive)
        table = pd.concat(_watched(f"localizing with {bundle.name}", rows, len(folder)), ignore_index=True)
        write_predictions(scratch / "predictions.csv", table)
        followed = _followed(bundle, folder, archive)
        least = list(bounds_of(bundle, folder, archive))
        scored = score(table, folder.manifest, folder.sensor)
        along = scored["recording"].map(learned_lines(whole.manifest)) != ""
        apart, unseen = scored[along], scored[~along]
        verdicts = tuple(check(bound, unseen, learned_depths_mm(whole.manifest)) for bound in read_bounds())
        card = json.loads((bundle / "model.json").read_text(encoding="utf-8"))
        metrics = measure(unseen, verdicts) | {
            "calibration_lines": {
                "names": [str(name) for name in apart["recording"].unique()],
                "end_of_stroke": summary(apart[apart["stroke_fraction"] == 1.0]),
            },
            "bundle": {"name": bundle.name, "card": card},
            "sensor": folder.sensor.name,
            "over_bound": over_bound(unseen, pd.concat(least)) if least else None,
        }
        metrics |= summaries(followed)
        # JSON has null alone for a number that is not finite.
        known = json.loads(json.dumps(metrics), parse_constant=lambda _: None)
        text = json.dumps(known, indent=1)
        (scratch / "metrics.json").write_text(text + "\n", encoding="utf-8")
        if report:
            write_report(scratch / "report.html", metrics, verdicts, unseen, followed, whole)
    shutil.rmtree(work_of(out), ignore_errors=True)
    return Evaluation(metrics, verdicts)


def work_of(out: Path) -> Path:
    """Where an evaluation into `out` keeps what is done."""
    return out.with_name(f".{out.name}.work")


def _watched(what: str, tables: Iterator[pd.DataFrame], recordings: int) -> Iterator[pd.DataFrame]:
    """The tables, with a bar that counts their recordings."""
    with progress_bar(what, "recording", total=recordings) as bar:
        for table in tables:
            yield table
            bar.update(table["recording"].nunique())


def _followed(bundle: Path, folder: Folder, archive: Archive) -> list[Track]:
    """Every recording that has its truth next to it; says how many of the chosen have none, if some have."""
    known = len(with_truth(folder))
    if 0 < known < len(folder):
        left_out = f"{len(folder) - known} of {len(folder)} recordings have no truth next to them"
        print(f"softslide evaluate: {left_out}; these are not followed over time", file=sys.stderr)
    followed = tracks(bundle, folder, archive)
    return list(progress_bar(f"following with {bundle.name}", "recording", followed, known))


def measure(scored: pd.DataFrame, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """`metrics.json`: bounds, then errors overall, for each split, direction, distance and speed.

    scored: without slides along calibration lines. `overall` and each of `splits` hold a summary for each stroke
    fraction; `coverage` is over all fractions, the others are at the end of the stroke.
    """
    end = scored[scored["stroke_fraction"] == 1.0]
    return {
        "bounds": [verdict.as_json() for verdict in verdicts],
        "overall": along_the_stroke(scored),
        "splits": {str(name): along_the_stroke(rows) for name, rows in scored.groupby("split")},
        "end_of_stroke": summary(end),
        "coverage": coverage(scored),
        "by_direction": by_direction(end),
        "by_distance": by_distance(end),
        "by_speed": by_speed(end),
    }


def write_predictions(path: Path, table: pd.DataFrame) -> None:
    """Writes the columns of docs/format.md: nine significant digits, true or false, empty where not estimated."""
    shown = table.assign(
        stroke_fraction=table["stroke_fraction"].map("{:.1f}".format),
        valid=table["valid"].map({True: "true", False: "false"}),
    )
    shown.to_csv(path, index=False, float_format="%.9g", lineterminator="\n")


def to_score(folder: Folder, splits: Sequence[str] | None) -> Folder:
    """The recordings of these splits, or of those that begin with `test`.

    Raises:
        InputError: a split that the folder does not have, or none that begins with `test`.
    """
    present = sorted(set(folder.manifest["split"]))
    place = f"{folder.root / 'manifest.csv'}: it has the splits {', '.join(present)}"
    if splits is None:
        chosen = folder.select("test")
        if not len(chosen):
            raise InputError(
                f"is needed: {place}, none begins with 'test'; name one, or plan tests too",
                "split",
            )
        return chosen
    if unknown := [split for split in splits if split not in present]:
        raise InputError(f"{place}, not '{unknown[0]}'; name one of these")
    return replace(folder, manifest=folder.manifest[folder.manifest["split"].isin(splits)])

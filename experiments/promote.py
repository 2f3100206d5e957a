"""A bundle challenges the champion: both read the same recordings, and lines decide."""

import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from experiments.evaluation.archive import Archive
from experiments.evaluation.readout import check_fits, open_localizer, predictions
from experiments.evaluation.scoring import score
from experiments.provenance import bundle_hash, data_tags
from experiments.tracking.registry import CHAMPION, MODEL, champion, fetched, make_champion, version_of
from experiments.tracking.run import Run, tracked
from features.card import read_card
from features.errors import InputError
from models.held_out import line_folds
from pipeline.recordings.folder import Folder, read_folder

QUANTITIES = ("direction_deg", "speed_percent", "offset_mm")
# A champion is chosen on recordings kept for that; where there are none, on those that report.
SPLITS = ("validation", "test")
LEAST_LINES = 5
# Of the one-sided test: a challenger no better than the margin is promoted in one challenge of twenty at most.
LEVEL = 0.05


@dataclass(frozen=True)
class Comparison:
    """The challenger against the champion, over lines.

    gain: mean share by which its errors are smaller. low: the lower end of the one-sided 95 % confidence interval.
    """

    lines: int
    recordings: int
    gain: float
    low: float
    champion: dict[str, float]
    challenger: dict[str, float]


def promote(
    bundle: Path,
    recordings: Path,
    splits: list[str] | None = None,
    margin: float = 0.05,
    jobs: int = 2,
    store: str | None = None,
) -> tuple[bool, list[str]]:
    """Moves the alias `champion` to this bundle if its errors are smaller by more than the margin; what was found.

    Each is read out at the end of each recording. For every quantity the errors are taken as shares of the champion's
    mean error; a line's gain is the mean difference over its recordings and quantities. The bundle is promoted when a
    paired one-sided t-test over lines (Student 1908) finds a mean gain above the margin at LEVEL. A recording that one
    alone estimates counts as a difference of 1 in its favour. Without a champion the bundle becomes it.

    Raises:
        InputError: the bundle, the folder or the store is not to be had, or too few lines have labels.
    """
    if not 0 <= margin < 1:
        raise InputError(f"{margin:g}: write a share from 0 up to 1", "margin")
    folder = _kept_for_this(read_folder(recordings), splits)
    check_fits(open_localizer(bundle), folder)
    digest, reigning = bundle_hash(bundle), champion(store)
    configuration = {
        "bundle": str(bundle),
        "recordings": str(recordings),
        "splits": sorted(set(folder.manifest["split"])),
        "margin": margin,
        "champion": reigning,
    }
    tags = {"bundle": digest} | data_tags(folder)
    parent = {"bundle": digest, "command": "train"}
    with tracked(
        "promote",
        f"{bundle.name} against {CHAMPION}",
        configuration,
        bundle,
        tags=tags,
        parent=parent,
        store=store,
    ) as run:
        if reigning is None:
            better, lines = True, [f"no {CHAMPION} yet"]
        else:
            with tempfile.TemporaryDirectory() as scratch:
                other = fetched(f"models:/{MODEL}/{reigning}", Path(scratch), store)
                found = compare(_errors(other, folder, jobs), _errors(bundle, folder, jobs), folder.manifest)
            better = found.low > margin
            lines = _told(found, margin, reigning)
            run.metrics({"gain": found.gain, "gain_low": found.low, "lines": found.lines})
        version = reigning
        if better:
            version = version_of(digest, store) or _registered(run, bundle, digest, store)
            make_champion(version, store)
        lines.append(f"models:/{MODEL}@{CHAMPION} {'is now' if better else 'stays'} version {version}")
        run.tags({"promoted": str(better).lower()})
    return better, lines


def compare(champion: pd.DataFrame, challenger: pd.DataFrame, manifest: pd.DataFrame) -> Comparison:
    """The paired comparison. Both: absolute errors in the columns QUANTITIES, a row a recording; NaN: not estimated.

    Raises:
        InputError: fewer than LEAST_LINES lines.
    """
    scale = champion.mean().clip(lower=1e-9)
    difference = (champion - challenger) / scale
    # Where both are silent nothing is compared.
    difference = difference.mask(champion.isna() & challenger.notna(), 1.0)
    difference = difference.mask(champion.notna() & challenger.isna(), -1.0)
    gain = difference.mean(axis=1).dropna()
    labels = manifest.loc[gain.index]
    line = line_folds(labels["direction_deg"].to_numpy(), labels["offset_mm"].to_numpy(), len(labels) + 1)
    by_line = gain.groupby(line).mean().to_numpy()
    if len(by_line) < LEAST_LINES:
        raise InputError(
            f"recordings along {len(by_line)} lines; {LEAST_LINES} at least tell better from luck, record more"
        )
    mean = float(by_line.mean())
    error = float(by_line.std(ddof=1) / np.sqrt(len(by_line)))
    low = mean - float(stdtrit(len(by_line) - 1, 1 - LEVEL)) * error
    return Comparison(len(by_line), len(gain), mean, low, dict(champion.mean()), dict(challenger.mean()))


def _kept_for_this(whole: Folder, splits: list[str] | None) -> Folder:
    """The labelled recordings of these splits, or of the first of SPLITS that begins the name of any.

    Raises:
        InputError: there are none.
    """
    for prefix in SPLITS if splits is None else ("",):
        folder = whole.select(prefix).labelled()
        if splits is not None:
            folder = replace(folder, manifest=folder.manifest[folder.manifest["split"].isin(splits)])
        if len(folder):
            if prefix == "test":
                print(
                    "softslide promote: compares on splits that begin with 'test', whose figures then flatter the "
                    "champion; keep a split 'validation' for it",
                    file=sys.stderr,
                )
            return folder
    wanted = " or ".join(splits or SPLITS)
    raise InputError(
        f"{whole.root / 'manifest.csv'}: no labelled recording of a split {wanted}; name another"
    )


def _errors(bundle: Path, folder: Folder, jobs: int) -> pd.DataFrame:
    """Absolute errors at the end of each recording, in the columns QUANTITIES."""
    check_fits(open_localizer(bundle), folder)
    table = pd.concat(predictions(bundle, folder, Archive(jobs)), ignore_index=True)
    end = score(table[table["stroke_fraction"] == 1.0], folder.manifest, folder.sensor).set_index("recording")
    return end[[f"{name}_error" for name in QUANTITIES]].set_axis(list(QUANTITIES), axis=1).astype(float)


def _registered(run: Run, bundle: Path, digest: str, store: str | None) -> str:
    """Registers the bundle; its version."""
    run.model(bundle, read_card(bundle / "model.json").model)
    run.register(MODEL, {"bundle": digest})
    version = version_of(digest, store)
    if version is None:
        raise InputError(f"{bundle}: not registered; run 'softslide sync', then promote again")
    return version


def _told(found: Comparison, margin: float, reigning: str) -> list[str]:
    """The comparison in lines."""
    lines = [
        f"{name}: {CHAMPION} (version {reigning}) {found.champion[name]:.3g}, challenger {found.challenger[name]:.3g}"
        for name in QUANTITIES
    ]
    verdict = "better" if found.low > margin else "not better"
    return [
        *lines,
        f"errors smaller by {found.gain:.1%}, at least {found.low:.1%} (95 % confidence, {found.lines} lines, "
        f"{found.recordings} recordings): {verdict} by {margin:.0%}",
    ]

"""Scores of a followed contact: a bundle's estimates, block by block, against the truth of a recording.

An estimate counts where it is *live*: valid, in state `slide`. Direction, speed and offset are judged
where the contact moves at `MOVING_MM_S` or more; the rest wherever something touches. The offset is the tangent's.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.archive import Archive
from softslide.experiments.evaluation.readout import open_localizer, samples_for
from softslide.experiments.evaluation.scoring import INTERVALS
from softslide.features.angles import wrapped_deg
from softslide.features.estimate import Estimate, interval_ends
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.signed_offset import signed_offset
from softslide.pipeline.recordings.truth import truth_path
from softslide.serve.localizer import Localizer
from softslide.serve.records import record
from softslide.serve.whole_contacts import has_whole_contacts, whole_contacts

# Below this speed a contact counts as standing, without a direction.
MOVING_MM_S = 0.2
# An estimate is wrong where an error exceeds this many half widths of its 90 % interval, or one of the two below.
WRONG_HALF_WIDTHS = 3.0
GROSS_MM, GROSS_DEG = 5.0, 20.0
# Estimates with an interval.
BOUNDED = ("x_mm", "y_mm", "vx_mm_s", "vy_mm_s", *INTERVALS, "depth_mm")
# Quantities that are summarized, and their units.
QUANTITIES = {"position": "mm", "direction": "deg", "speed": "%", "offset": "mm", "depth": "mm"}
COVERED = ("position", "velocity", "direction", "speed", "offset", "depth")
_COLUMNS = [name for column in BOUNDED for name in (column, *interval_ends(column))]


@dataclass(frozen=True)
class Track:
    """One recording and what `judge` says of its estimates, a row a moment: of those of the stream, and of those from
    whole contacts (`serve.whole_contacts`), of which there are none where the bundle does not know these."""

    name: str
    split: str
    estimates: pd.DataFrame
    from_whole: pd.DataFrame


def with_truth(folder: Folder) -> Folder:
    """The recordings whose truth lies next to them."""
    there = [truth_path(folder.root / file).is_file() for file in folder.manifest["file"]]
    return replace(folder, manifest=folder.manifest[np.array(there, bool)])


def tracks(bundle: Path, folder: Folder, archive: Archive) -> Iterator[Track]:
    """Every recording that has its truth, in the manifest's order.

    Raises:
        InputError: a recording or its truth is not what the contract says.
    """
    for table in archive.tables("tracks", _judged, bundle, with_truth(folder)):
        for name, both in table.groupby("recording", sort=False):
            of_stream, from_whole = (
                both[both["whole"] == each].drop(columns=["recording", "whole"]).reset_index(drop=True)
                for each in (False, True)
            )
            yield Track(str(name), str(folder.manifest.loc[str(name), "split"]), of_stream, from_whole)


def _judged(bundle: Path, folder: Folder) -> pd.DataFrame:
    localizer = open_localizer(bundle, folder.sensor.sample_rate_hz)
    ways = [_live, whole_contacts] if has_whole_contacts(localizer.card) else [_live]
    tables = []
    for name in folder.manifest.index:
        recording = folder.load(name)
        assert recording.truth is not None
        for way in ways:
            estimates = way(localizer, samples_for(localizer, recording))
            stream = estimate_table([record(estimate) for estimate in estimates])
            stream["time_s"] += recording.time_s[0]
            judged = judge(stream, recording.truth, folder.sensor.reference_mm)
            tables.append(judged.assign(recording=name, whole=way is whole_contacts))
    return pd.concat(tables)


def _live(localizer: Localizer, volts: np.ndarray) -> list[Estimate]:
    localizer.reset()
    return localizer.push(volts)


def estimate_table(records: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Estimates, as `serve.records.record` writes them, in numbers: time_s, state, valid and the columns of `BOUNDED`.

    NaN where nothing is estimated. A stream of velocities alone gets its direction and speed from these.
    """
    stream = pd.DataFrame.from_records(records)
    table = stream.reindex(columns=["time_s", *_COLUMNS]).apply(pd.to_numeric, errors="coerce").astype(float)
    if table["direction_deg"].isna().all():
        table["direction_deg"] = np.rad2deg(np.arctan2(table["vy_mm_s"], table["vx_mm_s"])) % 360
        table["speed_mm_s"] = np.hypot(table["vx_mm_s"], table["vy_mm_s"])
    table["state"] = stream["state"].astype(str) if "state" in stream else "slide"
    table["valid"] = stream["valid"].astype(bool)
    return table


def judge(stream: pd.DataFrame, truth: pd.DataFrame, reference_mm: tuple[float, float]) -> pd.DataFrame:
    """One row for each estimate: the estimate, `true_*` at its moment, errors, and whether it is wrong.

    stream: as `estimate_table` returns it. Errors are signed but the position's, in the units of `QUANTITIES`. `*_held`
    is the share of the quantity's intervals, of one or two of them, that hold the truth: NaN without one.
    """
    true = _true_at(stream["time_s"].to_numpy(), truth, reference_mm)
    table = stream.join(true.add_prefix("true_"))
    table["touching"] = _touching(stream["time_s"].to_numpy(), truth)
    table["moving"] = table["touching"] & (true["speed_mm_s"] >= MOVING_MM_S)
    table["live"] = stream["valid"] & (stream["state"] == "slide")
    table["ended"] = stream["valid"] & (stream["state"] == "ended")

    errors = stream[list(BOUNDED)] - true[list(BOUNDED)]
    errors["direction_deg"] = wrapped_deg(errors["direction_deg"].to_numpy())
    table["position_error"] = np.hypot(errors["x_mm"], errors["y_mm"])
    table["speed_error"] = 100 * (stream["speed_mm_s"] / true["speed_mm_s"].clip(lower=1e-9) - 1)
    for column in ("direction_deg", "offset_mm", "depth_mm"):
        table[f"{column.split('_')[0]}_error"] = errors[column]

    off, half = _from_middles(stream, true)
    held = (off.abs() <= half).astype(float).where(half.notna() & true[half.columns].notna())
    for column in (*INTERVALS, "depth_mm"):
        table[f"{column.split('_')[0]}_held"] = held[column]
    table["position_held"] = (held["x_mm"] + held["y_mm"]) / 2
    table["velocity_held"] = (held["vx_mm_s"] + held["vy_mm_s"]) / 2

    wide = errors.abs() > WRONG_HALF_WIDTHS * half
    beyond = wide[["x_mm", "y_mm", "speed_mm_s"]].any(axis=1)
    beyond |= wide[["direction_deg", "offset_mm"]].any(axis=1) & table["moving"]
    turned = (table["direction_error"].abs() > GROSS_DEG) & table["moving"]
    table["gross"] = (table["position_error"] > GROSS_MM) | turned
    table["wrong"] = table["gross"] | beyond
    return table


def summarize(judged: Sequence[pd.DataFrame]) -> dict[str, Any]:
    """One row of the report's table, from one table of `judge` a recording.

    Shares are of the moments of contact (`valid`), of those that move (`ended`: still valid, of a slide that is over),
    of those that stand (`still`: a speed above `MOVING_MM_S` is claimed), or of the live ones in contact (`wrong`,
    `gross`). `phantom_s`: seconds a recording that are live without contact. `first_s`: from the touch to the first
    live estimate; `never`: recordings without one.
    """
    rows = pd.concat(judged, ignore_index=True)
    contact = rows[rows["touching"]]
    live = contact[contact["live"]]
    moving, still = live[live["moving"]], contact[~contact["moving"]]
    block_s = float(np.median(np.concatenate([np.diff(each["time_s"]) for each in judged])))
    first = np.array([_first(each) for each in judged])
    result: dict[str, Any] = {
        "recordings": len(judged),
        "valid_share": _mean(contact["live"]),
        "ended_share": _mean(contact.loc[contact["moving"], "ended"]),
        "wrong_share": _mean(live["wrong"]),
        "gross_share": _mean(live["gross"]),
        "still_share": _mean(still["live"] & (still["speed_mm_s"] > MOVING_MM_S)),
        "phantom_s": float((rows["live"] & ~rows["touching"]).sum() * block_s / len(judged)),
        "first_s": _median_and_p95(first),
        "never": int(np.isnan(first).sum()),
    }
    for quantity in QUANTITIES:
        judged_rows = live if quantity in ("position", "depth") else moving
        result[quantity] = _median_and_p95(judged_rows[f"{quantity}_error"].to_numpy(float))
    for quantity in COVERED:
        judged_rows = moving if quantity in ("direction", "speed", "offset") else live
        result[f"{quantity}_coverage"] = _mean(judged_rows[f"{quantity}_held"])
    return result


def by_split(followed: Sequence[Track]) -> dict[str, list[Track]]:
    """The tracks of each split, in the order of their first recordings."""
    splits = dict.fromkeys(track.split for track in followed)
    return {split: [track for track in followed if track.split == split] for split in splits}


def summaries(followed: Sequence[Track]) -> dict[str, dict[str, dict[str, Any]]]:
    """`summarize` for each split, as `metrics.json` has it: of the `tracks`, of the `whole_contacts` if any."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for split, part in by_split(followed).items():
        found.setdefault("tracks", {})[split] = summarize([each.estimates for each in part])
        if whole := [each.from_whole for each in part if len(each.from_whole)]:
            found.setdefault("whole_contacts", {})[split] = summarize(whole)
    return found


def line(split: str, row: dict[str, Any]) -> str:
    """A summary in one line."""

    def share(name: str) -> str:
        return "-" if row[name] is None else f"{100 * row[name]:.0f} %"

    errors = ", ".join(
        f"{quantity} {row[quantity]['median']:.2g} {unit}"
        for quantity, unit in QUANTITIES.items()
        if row[quantity]["median"] is not None
    )
    summed = f"median errors: {errors}" if errors else "no estimate"
    return f"{split}: valid {share('valid_share')} of the contact, of these wrong {share('wrong_share')}; {summed}"


def _true_at(time_s: np.ndarray, truth: pd.DataFrame, reference_mm: tuple[float, float]) -> pd.DataFrame:
    """The truth at (n,) s, in the columns of `BOUNDED`; direction, speed and offset are the tangent's."""
    clock = truth["time_s"].to_numpy()
    names = ("x_mm", "y_mm", "vx_mm_s", "vy_mm_s", "depth_mm")
    true = pd.DataFrame({name: np.interp(time_s, clock, truth[name].to_numpy(float)) for name in names})
    angle = np.arctan2(true["vy_mm_s"], true["vx_mm_s"])
    true["direction_deg"] = np.rad2deg(angle) % 360
    true["speed_mm_s"] = np.hypot(true["vx_mm_s"], true["vy_mm_s"])
    true["offset_mm"] = signed_offset(angle, true["x_mm"] - reference_mm[0], true["y_mm"] - reference_mm[1])
    return true


def _touching(time_s: np.ndarray, truth: pd.DataFrame) -> np.ndarray:
    """(n,) whether something touches, by the truth's first row that is not earlier."""
    at = np.clip(np.searchsorted(truth["time_s"].to_numpy(), time_s), 0, len(truth) - 1)
    return truth["contact"].to_numpy()[at] > 0


def _from_middles(stream: pd.DataFrame, true: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Distance of the truth from the middle of each interval, and the half width; NaN without one."""
    columns = {name: [stream[end] for end in interval_ends(name)] for name in BOUNDED}
    half = pd.DataFrame({name: (high - low) / 2 for name, (low, high) in columns.items()})
    off = pd.DataFrame({name: true[name] - (low + high) / 2 for name, (low, high) in columns.items()})
    off["direction_deg"] = wrapped_deg(off["direction_deg"].to_numpy())
    return off, half


def _first(judged: pd.DataFrame) -> float:
    """Seconds from the touch to the first live estimate; NaN without one."""
    touching = judged.loc[judged["touching"], "time_s"]
    return judged.loc[judged["touching"] & judged["live"], "time_s"].min() - touching.min()


def _mean(values: pd.Series) -> float | None:
    known = values.dropna()
    return float(known.mean()) if len(known) else None


def _median_and_p95(values: np.ndarray) -> dict[str, float | None]:
    size = np.abs(values[np.isfinite(values)])
    if not len(size):
        return {"median": None, "p95": None}
    return {"median": float(np.median(size)), "p95": float(np.percentile(size, 95))}

"""The import: sources and a map in, a folder of recordings out. It resumes, and two imports are identical.

Finished recordings wait in a hidden folder next to the output, with a journal that says from which files and
with which map they were made. An interrupted import resumes from it; bad input removes it.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial as bound
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from softslide.features.clock import check_clock
from softslide.features.errors import InputError, printable
from softslide.features.names import REMEDY, is_plain
from softslide.features.units import impossible_output
from softslide.pipeline.checks.zone_signs import sign_agreement, start_mm
from softslide.pipeline.importers.guess import cure, kind_of
from softslide.pipeline.importers.import_map import Map, compiled
from softslide.pipeline.importers.labels import Row, label_columns, label_row, read_sheet, recording_name
from softslide.pipeline.importers.messages import clock_notes, inverted, mounting_notes
from softslide.pipeline.importers.onset import INSIDE_MM, onset_s
from softslide.pipeline.importers.readers.registry import READERS
from softslide.pipeline.importers.resampling import Samples
from softslide.pipeline.importers.resume import Journal, fingerprint, size_bytes
from softslide.pipeline.importers.streams import Source, write_even
from softslide.pipeline.importers.units import converter
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.manifest import check_manifest, write_manifest
from softslide.pipeline.recordings.slide_file import read_slide, read_slide_in_blocks, write_slide_in_blocks
from softslide.pipeline.sensor import Sensor, write_sensor
from softslide.pipeline.staging import alone, staged

# Signs and onsets look at a slide as a whole; a longer one than this (half an hour at 1 kHz) is left out.
WHOLE_SAMPLES = 2_000_000


@dataclass(frozen=True)
class Imported:
    """What an import did: the folder, how many recordings are new, and its messages."""

    out: Path
    recordings: int
    resumed: int
    notes: tuple[str, ...]


def import_files(sources: Sequence[Path], mapping: Map, out: Path) -> Imported:
    """Imports every recording found in the sources.

    Raises:
        InputError: a source, the map or a label is bad; nothing is left then.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: a file of this name is in the way; name a folder")
    jobs = find_sources(sources, mapping)
    partial = out.parent / f".{out.name}.partial"
    import_one = bound(
        _import_one, mapping=mapping, sheet=read_sheet(mapping), to_volts=converter(mapping), partial=partial
    )
    with alone(partial, out):
        # Nothing is left in it but by a process that is killed or a disk that is full.
        try:
            journal = Journal(partial, mapping)
            resumed = _import_new(jobs, journal, import_one, mapping)
            notes = _finish(jobs, mapping, journal, partial, out)
        except InputError:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        shutil.rmtree(partial)
    return Imported(out, len(jobs), resumed, tuple(notes))


def _import_new(
    jobs: Sequence[Source], journal: Journal, import_one: Callable[..., dict[str, Any]], mapping: Map
) -> int:
    """Imports what an earlier call had not; how many recordings it had."""
    resumed = done = 0
    total = sum(size_bytes(path) for job in jobs for path in job.files.values())
    with progress_bar("import", "B", total=total) as bar:

        def progress(portion: float, job: Source) -> None:
            bar.update(int(done + portion * sum(map(size_bytes, job.files.values()))) - bar.n)

        for job in jobs:
            if journal.has(job):
                resumed += 1
            else:
                try:
                    journal.add(job, import_one(job, progress=bound(progress, job=job)))
                except InputError as error:
                    raise InputError(f"{error}{cure(next(iter(job.files.values())), mapping)}") from None
            progress(1.0, job)
            done = bar.n
    return resumed


def find_sources(sources: Sequence[Path], mapping: Map) -> list[Source]:
    """The recordings in files and folders, sorted by name; folders are searched for the map's kind.

    Raises:
        InputError: a source is missing, a file named does not fit the pattern, two files claim one place, a recording's
            name is not plain.
    """
    pattern = compiled(mapping.pattern)
    found: dict[str, Source] = {}
    for source in sources:
        if not source.exists():
            raise InputError(f"{source}: no such file or folder; name one that exists")
        for path in _files(source, mapping.kind):
            # A pattern with a / is looked for in the path below the source.
            below = "/" in mapping.pattern and path != source
            match = pattern.search(path.relative_to(source).as_posix() if below else path.name)
            if match is None:
                if path == source:
                    raise InputError(
                        f"{path}: its name does not fit the map's pattern '{mapping.pattern}'; correct one"
                    )
                continue
            groups = {key: text or "" for key, text in match.groupdict().items()}
            name, part = recording_name(mapping, path, groups), groups.get("part", "")
            if not is_plain(name):
                raise InputError(f"{path}: recording '{printable(name)}': a name holds {REMEDY}")
            job = found.setdefault(name, Source(name, groups))
            if part in job.files:
                raise InputError(
                    f"{path}: recording '{name}' comes from {job.files[part]} too; separate them in pattern"
                )
            job.files[part] = path
    if not found:
        kinds = ", ".join(READERS[mapping.kind].suffixes)
        there = kind_of([path for source in sources if source.is_dir() for path in source.rglob("*")])
        remedy = (
            f'the files there are of kind = "{there}"'
            if there not in ("", mapping.kind)
            else "name its folder"
        )
        raise InputError(f"{', '.join(map(str, sources))}: no file ({kinds}) fits the map; {remedy}")
    return [found[name] for name in sorted(found)]


def _files(source: Path, kind: str) -> list[Path]:
    """A file itself; a folder's files of the kind. The folder of a ROS 2 bag is one source."""
    if not source.is_dir() or (kind == "ros" and (source / "metadata.yaml").exists()):
        return [source]
    inside = sorted(source.rglob("*"))
    bags = [path for path in inside if kind == "ros" and (path / "metadata.yaml").is_file()]
    files = [path for path in inside if path.is_file() and path.suffix.lower() in READERS[kind].suffixes]
    return bags + [path for path in files if path.parent not in bags]


def _import_one(
    job: Source,
    mapping: Map,
    sheet: dict[str, dict[Any, str]],
    to_volts: Callable[[np.ndarray], np.ndarray],
    partial: Path,
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Writes one recording's slide; returns its row, its clock and what the zones say of its signs."""
    sensor = mapping.sensor
    slide = partial / "raw" / f"{job.name}.parquet"
    source = next(iter(job.files.values()))
    if not label_columns(mapping):
        _checked_row(label_row(mapping, job.name, source, job.groups, sheet, {}), sensor, source)

    def write(blocks: Iterator[Samples]) -> None:
        write_slide_in_blocks(slide, ((t, to_volts(raw)) for t, raw in blocks), sensor.columns)

    reading = write_even(job, mapping, progress, write)
    row = label_row(mapping, job.name, source, job.groups, sheet, reading.cells)
    labels = _checked_row(row, sensor, source)
    entry: dict[str, Any] = {"row": row, "clock": asdict(reading.clock), "agreement": None, "shift_s": None}
    if pq.read_metadata(slide).num_rows > WHOLE_SAMPLES:
        return entry
    time_s, volts = read_slide(slide, sensor.channels)
    check_clock(source, time_s, sensor.sample_rate_hz)
    for k, part in enumerate(sensor.accelerometers):
        # Most of a recording is rest, or a slide of a few hundredths of a g.
        if text := impossible_output(np.median(volts[:, 3 * k : 3 * k + 3], axis=0), asdict(part)):
            raise InputError(f"{source}: {part.name}: {text}")
    recording = Recording(job.name, time_s, volts)
    if mapping.time.align == "onset" and not np.isnan(shift := _shift_s(recording, labels, sensor)):
        entry["shift_s"] = shift
        for moment in ("motion_start_s", "motion_end_s"):
            moved = float(np.clip(float(labels[moment]) + shift, time_s[0], time_s[-1]))
            row[moment] = labels[moment] = moved
    agreement = sign_agreement(recording, labels, sensor)
    entry["agreement"] = [
        [None if np.isnan(v) else round(float(v), 4) for v in part.flat] for part in agreement
    ]
    return entry


def _checked_row(row: Row, sensor: Sensor, source: Path) -> pd.Series:
    try:
        return check_manifest(pd.DataFrame([{**row, "file": "-"}]), sensor, source).iloc[0]
    except InputError as error:
        raise InputError(str(error).replace("row 1 (", "recording (")) from None


def _shift_s(recording: Recording, labels: pd.Series, sensor: Sensor) -> float:
    """How much later than labelled the motion starts, by the onset; NaN where labels or onset do not say.

    The skin begins to bend once the object has reached the inflated chamber, a little after the stage starts.
    """
    if labels[["motion_start_s", "motion_end_s", "speed_mm_s"]].isna().any():
        return float("nan")
    lead_s = 0.0
    if labels[["direction_deg", "start_x_mm", "start_y_mm"]].notna().all():
        angle = np.deg2rad(labels["direction_deg"])
        outside = -(start_mm(labels, sensor) @ (np.cos(angle), np.sin(angle))) - min(sensor.chamber_mm) / 2
        lead_s = (max(float(outside), 0.0) + INSIDE_MM) / labels["speed_mm_s"]
    return onset_s(recording) - lead_s - float(labels["motion_start_s"])


def _finish(jobs: Sequence[Source], mapping: Map, journal: Journal, partial: Path, out: Path) -> list[str]:
    """Turns the finished recordings into the folder; returns its messages."""
    entries = [journal.entries[job.name] for job in jobs]
    flips, notes = inverted(entries, mapping)
    notes = [*clock_notes(entries, mapping), *mounting_notes(mapping), *notes]
    rows = [{**entry["row"], "file": f"slides/{entry['recording']}.parquet"} for entry in entries]
    manifest = check_manifest(pd.DataFrame(rows), mapping.sensor, out / "manifest.csv")
    with staged(out) as scratch:
        (scratch / "slides").mkdir()
        for name, file in manifest["file"].items():
            raw = partial / "raw" / f"{name}.parquet"
            if flips:
                blocks = (
                    (t, _flipped(volts, flips))
                    for t, volts in read_slide_in_blocks(raw, mapping.sensor.columns)
                )
                write_slide_in_blocks(scratch / file, blocks, mapping.sensor.columns)
            else:
                os.replace(raw, scratch / file)
        write_sensor(scratch / "sensor.toml", mapping.sensor)
        write_manifest(scratch / "manifest.csv", manifest)
        report = {
            "kind": mapping.kind,
            "map": fingerprint(mapping),
            "notes": notes,
            "recordings": [
                {
                    "recording": entry["recording"],
                    "sources": [Path(path).name for path, _, _ in entry["sources"]],
                    **entry["clock"],
                    "shift_s": entry["shift_s"],
                }
                for entry in entries
            ],
        }
        (scratch / "import.json").write_text(json.dumps(report, indent=1) + "\n")
    return notes


def _flipped(volts: np.ndarray, flips: dict[int, float]) -> np.ndarray:
    volts = volts.copy()
    for channel, zero_g_v in flips.items():
        volts[:, channel] = 2 * zero_g_v - volts[:, channel]
    return volts

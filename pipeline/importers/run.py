"""`softslide import`: sources and a map in, a folder of recordings out. It resumes, and two imports are identical.

Finished recordings wait in a hidden folder next to the output, with what says from which files and with which map they
were made. An interrupted import resumes from it; bad input removes it.
"""

import json
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq

from softslide.features.clock import check_clock
from softslide.features.errors import InputError
from softslide.features.units import impossible_output
from softslide.pipeline.checks.zone_signs import sign_agreement, start_mm
from softslide.pipeline.importers.grid.assemble import import_grid
from softslide.pipeline.importers.grid.grid_map import read_grid_map
from softslide.pipeline.importers.guess import cure
from softslide.pipeline.importers.import_map import Map, read_map
from softslide.pipeline.importers.labels import Row, SheetRows, label_columns, label_row, read_sheet
from softslide.pipeline.importers.messages import clock_notes, inverted, mounting_notes
from softslide.pipeline.importers.onset import INSIDE_MM, onset_s
from softslide.pipeline.importers.resume import Journal
from softslide.pipeline.importers.sources import Source, find_sources
from softslide.pipeline.importers.streams import Progress, write_even
from softslide.pipeline.importers.units import Converter, converter
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.recordings.folder import Recording
from softslide.pipeline.recordings.manifest import check_manifest, write_manifest
from softslide.pipeline.recordings.slide_file import read_slide, read_slide_in_blocks, write_slide_in_blocks
from softslide.pipeline.sensor import Sensor, write_sensor
from softslide.pipeline.staging import alone, check_replaceable, staged
from softslide.pipeline.toml_tables import read_toml

# Signs and onsets look at a slide as a whole; a longer one than this (half an hour at 1 kHz) is left out.
WHOLE_SAMPLES = 2_000_000
# What import.json says of each recording.
REPORTED = ("recording", "sources", "samples", "largest_gap_s", "resampled", "shift_s")


@dataclass(frozen=True)
class Imported:
    """What an import did: the folder, how many recordings are new, and its messages."""

    out: Path
    recordings: int
    resumed: int
    notes: tuple[str, ...]


def import_recordings(
    sources: str | Path | Sequence[str | Path], map: str | Path, out: str | Path
) -> Imported:
    """Imports what a map says of the sources, files or folders to search; an interrupted import resumes.

    Raises:
        InputError: a source, the map or a label is bad; nothing is left then.
    """
    files = [Path(each) for each in ([sources] if isinstance(sources, str | Path) else sources)]
    map, out = Path(map), Path(out)
    if read_toml(map, "name a map, or start from a template").get("kind") != "grid":
        return import_files(files, read_map(map), out)
    if len(files) > 1:
        raise InputError(f"{files[1]}: a grid of presses is one file; import each to a folder")
    folder, notes = import_grid(files[0], read_grid_map(map), out)
    return Imported(out, len(folder), 0, tuple(notes))


def volts_of(files: Sequence[Path], map: Path, out: Path) -> list[Path]:
    """A lab's own files as recordings in V, for a model to read: no label, and of the pattern the parts alone.

    Raises:
        InputError: as an import, or the map leaves signs to labelled slides, which these are not.
    """
    mapping = read_map(map)
    if mapping.signs == "zones":
        raise InputError(
            f'{map}: signs = "zones" needs labelled slides; write "given", and what import flipped under [boards]'
        )
    whole = all(not signal.part for signal in mapping.channels.values())
    pattern = r"(?P<recording>.+)\." if whole else mapping.pattern
    import_files(files, replace(mapping, pattern=pattern, labels={}, sheet=None), out)
    return sorted((out / "slides").iterdir())


def import_files(sources: Sequence[Path], mapping: Map, out: Path) -> Imported:
    """Imports every recording found in the sources.

    Raises:
        InputError: a source, the map or a label is bad; nothing is left then.
    """
    check_replaceable(out)
    jobs = find_sources(sources, mapping)
    sheet, to_volts = read_sheet(mapping), converter(mapping)
    partial = out.parent / f".{out.name}.partial"
    with alone(partial, out):
        # Nothing is left in it but by a process that is killed or a disk that is full.
        try:
            journal = Journal(partial, mapping)
            entries, resumed = [], 0
            for job, progress in _with_progress(jobs):
                entry = journal.find(job)
                resumed += entry is not None
                if entry is None:
                    found = _import_one(job, mapping, sheet, to_volts, journal.slide(job.name), progress)
                    entry = journal.add(job, found)
                entries.append(entry)
            notes = _finish(entries, mapping, journal, out)
        except InputError:
            shutil.rmtree(partial, ignore_errors=True)
            raise
        shutil.rmtree(partial)
    return Imported(out, len(jobs), resumed, tuple(notes))


def _with_progress(jobs: Sequence[Source]) -> Iterator[tuple[Source, Progress]]:
    """Each job, and a function that takes the portion of it that is done, under a bar that counts bytes."""
    sizes = [sum(size for _, size, _ in job.stamp()) for job in jobs]
    with progress_bar("import", "B", total=sum(sizes)) as bar:
        for job, size in zip(jobs, sizes, strict=True):

            def progress(portion: float, before: float = bar.n, size: int = size) -> None:
                bar.update(int(before + portion * size) - bar.n)

            yield job, progress
            progress(1.0)


def _import_one(
    job: Source, mapping: Map, sheet: SheetRows, to_volts: Converter, slide: Path, progress: Progress
) -> dict[str, Any]:
    """Writes one recording's slide; returns its row, its clock and what the zones say of its signs."""
    try:
        if not label_columns(mapping):
            _checked_row(label_row(mapping, job, sheet, {}), mapping.sensor, job.path)
        reading = write_even(job, mapping, to_volts, slide, progress)
        row = label_row(mapping, job, sheet, reading.cells)
        labels = _checked_row(row, mapping.sensor, job.path)
        entry = {"row": row, **asdict(reading.clock), "shift_s": None, "agreement": None}
        if pq.read_metadata(slide).num_rows > WHOLE_SAMPLES:
            return entry
        recording = Recording(job.name, *read_slide(slide, mapping.sensor.channels))
        _check_signals(recording, mapping.sensor, job.path)
    except InputError as error:
        raise InputError(f"{error}{cure(job.path, mapping)}") from None
    if mapping.time.align == "onset" and not np.isnan(shift := _shift_s(recording, labels, mapping.sensor)):
        entry["shift_s"] = shift
        for moment in ("motion_start_s", "motion_end_s"):
            moved = float(np.clip(float(labels[moment]) + shift, *recording.time_s[[0, -1]]))
            row[moment] = labels[moment] = moved
    agreement, _ = sign_agreement(recording, labels, mapping.sensor)
    entry["agreement"] = [
        [None if np.isnan(v) else round(float(v), 4) for v in part.flat] for part in agreement
    ]
    return entry


def _checked_row(row: Row, sensor: Sensor, source: Path) -> pd.Series:
    try:
        return check_manifest(pd.DataFrame([{**row, "file": "-"}]), sensor, source).iloc[0]
    except InputError as error:
        raise InputError(str(error).replace("row 1 (", "recording (")) from None


def _check_signals(recording: Recording, sensor: Sensor, source: Path) -> None:
    """Refuses a clock that is not the sensor's, and outputs that no accelerometer has."""
    check_clock(source, recording.time_s, sensor.sample_rate_hz)
    for k, part in enumerate(sensor.accelerometers):
        # Most of a recording is rest, or a slide of a few hundredths of a g.
        if text := impossible_output(np.median(recording.volts[:, 3 * k : 3 * k + 3], axis=0), asdict(part)):
            raise InputError(f"{source}: {part.name}: {text}")


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


def _finish(entries: Sequence[dict[str, Any]], mapping: Map, journal: Journal, out: Path) -> list[str]:
    """Turns the finished recordings into the folder; returns its messages."""
    sensor = mapping.sensor
    flips, notes = inverted(entries, mapping)
    notes = [*clock_notes(entries, mapping), *mounting_notes(mapping), *notes]
    rows = [{**entry["row"], "file": f"slides/{entry['recording']}.parquet"} for entry in entries]
    manifest = check_manifest(pd.DataFrame(rows), sensor, out / "manifest.csv")
    with staged(out) as scratch:
        (scratch / "slides").mkdir()
        for name, file in manifest["file"].items():
            slide = journal.slide(str(name))
            if flips:
                blocks = read_slide_in_blocks(slide, sensor.columns)
                mirrored = ((time_s, _mirrored(volts, flips)) for time_s, volts in blocks)
                write_slide_in_blocks(scratch / file, mirrored, sensor.columns)
            else:
                _link(slide, scratch / file)
        write_sensor(scratch / "sensor.toml", sensor)
        write_manifest(scratch / "manifest.csv", manifest)
        recordings = []
        for entry in entries:
            names = [Path(path).name for path, _, _ in entry["sources"]]
            recordings.append({key: entry[key] for key in REPORTED} | {"sources": names})
        report = {"kind": mapping.kind, "map": journal.map, "notes": notes, "recordings": recordings}
        (scratch / "import.json").write_text(json.dumps(report, indent=1) + "\n")
    return notes


def _link(file: Path, place: Path) -> None:
    """A second name for the file, which keeps its first until the folder is whole; a copy where a disk has no links."""
    try:
        os.link(file, place)
    except OSError:
        shutil.copyfile(file, place)


def _mirrored(volts: np.ndarray, flips: dict[int, float]) -> np.ndarray:
    """volts (n, channels) V, of which those channels are mirrored at those volts."""
    volts = volts.copy()
    for channel, zero_g_v in flips.items():
        volts[:, channel] = 2 * zero_g_v - volts[:, channel]
    return volts

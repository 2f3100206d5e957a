"""The journal of an import's finished recordings, from which an interrupted import resumes."""

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from softslide.pipeline.importers.import_map import Map
from softslide.pipeline.importers.streams import Source
from softslide.pipeline.staging import writing


class Journal:
    """What is finished: one JSON line a recording, after one line for the map."""

    def __init__(self, partial: Path, mapping: Map) -> None:
        self.path = partial / "journal.jsonl"
        self.entries: dict[str, dict[str, Any]] = {}
        head = json.dumps({"map": fingerprint(mapping)})
        lines = self.path.read_text().splitlines() if self.path.is_file() else []
        resumes = lines[:1] == [head]
        if resumes:
            # A line that was being written when the import was interrupted does not end.
            whole = [line for line in lines[1:] if line.endswith("}")]
            self.entries = {entry["recording"]: entry for entry in map(json.loads, whole)}
        else:
            shutil.rmtree(partial / "raw", ignore_errors=True)
        with writing(partial.parent):
            # An import that was killed while it cleared up leaves a journal without the folder.
            (partial / "raw").mkdir(parents=True, exist_ok=True)
            if not resumes:
                self.path.write_text(head + "\n")

    def has(self, job: Source) -> bool:
        slide = self.path.parent / "raw" / f"{job.name}.parquet"
        return slide.is_file() and self.entries.get(job.name, {}).get("sources") == stamp(job)

    def add(self, job: Source, entry: dict[str, Any]) -> None:
        self.entries[job.name] = {"recording": job.name, "sources": stamp(job), **entry}
        with self.path.open("a") as file:
            file.write(json.dumps(self.entries[job.name]) + "\n")


def stamp(job: Source) -> list[list[Any]]:
    return [[str(path), size_bytes(path), path.stat().st_mtime_ns] for _, path in sorted(job.files.items())]


def fingerprint(mapping: Map) -> str:
    """A hash of the map and of every file that it names."""
    named = [board.calibration for board in mapping.boards.values() if board.calibration]
    named += [mapping.sheet.file] if mapping.sheet else []
    # Where the map lies does not change what it means.
    texts = [
        repr(replace(mapping, path=Path())),
        *((mapping.path.parent / name).read_text(errors="replace") for name in named),
    ]
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def size_bytes(path: Path) -> int:
    """Of a file, or of the files in a ROS 2 bag's folder."""
    if path.is_dir():
        return sum(file.stat().st_size for file in path.iterdir())
    return path.stat().st_size

"""An import's finished recordings, from which an interrupted one resumes: each a slide, and a note of its sources."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from softslide.pipeline.importers.import_map import Map
from softslide.pipeline.importers.sources import Source
from softslide.pipeline.staging import writing


class Journal:
    """What is finished: raw/NAME.parquet, and next to it NAME.json on the sources and the map that it is of."""

    def __init__(self, partial: Path, mapping: Map) -> None:
        self.folder, self.map = partial / "raw", fingerprint(mapping)
        with writing(partial.parent):
            self.folder.mkdir(parents=True, exist_ok=True)

    def slide(self, name: str) -> Path:
        """Where the recording's slide is."""
        return self.folder / f"{name}.parquet"

    def find(self, job: Source) -> dict[str, Any] | None:
        """What was noted of these very files with this map; None: they have not been finished, and what was noted of
        others is deleted."""
        note = self.folder / f"{job.name}.json"
        try:
            entry = json.loads(note.read_text())
            if self.slide(job.name).is_file() and (entry["map"], entry["sources"]) == (self.map, job.stamp()):
                return entry
        except (FileNotFoundError, ValueError):  # none, or one that was being written
            pass
        # The slide will be written anew: what was noted of another one no longer holds, which the folder of a call that
        # was killed at its very end may share.
        note.unlink(missing_ok=True)
        self.slide(job.name).unlink(missing_ok=True)
        return None

    def add(self, job: Source, entry: dict[str, Any]) -> dict[str, Any]:
        """Notes that the recording is finished; returns the entry, with its name, its sources and its map."""
        entry = {"recording": job.name, "map": self.map, "sources": job.stamp(), **entry}
        (self.folder / f"{job.name}.json").write_text(json.dumps(entry))
        return entry


def fingerprint(mapping: Map) -> str:
    """A hash of the map and of every file that it names."""
    named = [board.calibration for board in mapping.boards.values() if board.calibration]
    named += [mapping.sheet.file] if mapping.sheet else []
    # Where the map lies does not change what it means.
    texts = [repr(replace(mapping, path=Path()))]
    texts += [(mapping.path.parent / name).read_text(errors="replace") for name in named]
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()

"""A table over many recordings, made chunk by chunk on several processes; what is done survives the process.

Chunks and their order depend on the recordings alone: the result is the same for any number of processes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from softslide.experiments.cached import cached_table
from softslide.experiments.code_hash import code_hash
from softslide.experiments.provenance import bundle_hash
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.truth import truth_path
from softslide.pipeline.workers import results

# Recordings of a task: of some 0.2 s each, they take long next to the 11 ms that Dask asks for a task.
CHUNK = 4
# Called with the bundle and the folder of a chunk's recordings alone.
Make = Callable[[Path, Folder], pd.DataFrame]


@dataclass(frozen=True)
class Archive:
    """How a call works through its recordings. jobs, scheduler: as in `pipeline.workers.results`. work: a folder where
    each chunk's rows are kept, so that a call that was killed goes on where it stopped; without one, none are."""

    jobs: int = 2
    scheduler: str = ""
    work: Path | None = None

    def tables(self, what: str, make: Make, bundle: Path, folder: Folder) -> Iterator[pd.DataFrame]:
        """Each chunk's table, in the manifest's order. what: which table.

        Raises:
            InputError: as `make`.
        """
        work = self.work
        if self.scheduler:
            # Workers were started in folders of their own.
            bundle, work = bundle.resolve(), work and work.resolve()
            folder = replace(folder, root=folder.root.resolve())
        of_all = [what, bundle_hash(bundle), code_hash([make.__module__])] if work else []
        # What a task needs of the manifest.
        parts = [folder.manifest.iloc[n : n + CHUNK] for n in range(0, len(folder), CHUNK)]
        chunks = [Folder(folder.root, folder.sensor, part) for part in parts]
        calls = ((work, [*of_all, *_what_it_is_of(chunk)], make, bundle, chunk) for chunk in chunks)
        return results(_table, calls, self.jobs, self.scheduler)


def _table(work: Path | None, key: list[Any], make: Make, bundle: Path, chunk: Folder) -> pd.DataFrame:
    # A worker that outlives a call makes no new folder.
    kept_in = work if work and work.is_dir() else None
    return cached_table(kept_in, key, lambda: make(bundle, chunk))


def _what_it_is_of(chunk: Folder) -> list[Any]:
    """Its labels; size and time of change of each recording's files."""
    paths = [chunk.root / file for file in chunk.manifest["file"]]
    stats = [path.stat() for place in paths for path in (place, truth_path(place)) if path.exists()]
    return [chunk.manifest.to_csv(), [[each.st_size, each.st_mtime_ns] for each in stats]]

"""A table over many recordings, made chunk by chunk on several processes; what is done survives the process.

A chunk's rows are kept in a file of their own until the whole is written, so that a call that was killed goes on where
it stopped. Chunks and their order depend on the recordings alone: the result is the same for any number of processes.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.code_hash import code_hash
from experiments.provenance import bundle_hash
from pipeline.recordings.folder import Folder
from pipeline.recordings.truth import truth_path
from pipeline.staging import whole, writing
from pipeline.workers import results

# Recordings of a task: of some 0.2 s each, they take long next to the 11 ms that Dask asks for a task.
CHUNK = 4


class Archive:
    """How a call works through its recordings. jobs, scheduler: as in `pipeline.workers.results`. work: a folder for
    what is done, removed by `close`; None: nothing is kept."""

    def __init__(self, jobs: int = 2, scheduler: str = "", work: Path | None = None) -> None:
        self.jobs, self.scheduler, self.work = jobs, scheduler, work

    def tables(
        self, what: str, make: Callable[..., pd.DataFrame], bundle: Path, folder: Folder, names: Sequence[str]
    ) -> Iterator[pd.DataFrame]:
        """Each chunk's table, in the order of the names.

        what: which table. make: called as make(bundle, folder, names), the folder that of a chunk's recordings alone.

        Raises:
            InputError: as `make`, and where nothing can be kept.
        """
        if self.scheduler:
            # Workers were started in folders of their own.
            bundle, folder = bundle.resolve(), folder.at_its_place()
        parts = [list(names[n : n + CHUNK]) for n in range(0, len(names), CHUNK)]
        # What a task needs of the manifest.
        chunks = [Folder(folder.root, folder.sensor, folder.manifest.loc[part]) for part in parts]
        of_all = [what, bundle_hash(bundle), code_hash([make.__module__])]
        places = [self._place(of_all, chunk) for chunk in chunks]
        done = {place for place in places if place and place.exists()}
        missing = [chunk for chunk, place in zip(chunks, places, strict=True) if place not in done]
        calls = ((bundle, chunk, list(chunk.manifest.index)) for chunk in missing)
        made = results(make, calls, self.jobs, self.scheduler)
        for place in places:
            if place in done:
                yield pd.read_parquet(place)
                continue
            table = next(made)
            if place:
                with writing(place, "name another place"):
                    place.parent.mkdir(parents=True, exist_ok=True)
                    with whole(place) as scratch:
                        table.to_parquet(scratch)
            yield table

    def close(self) -> None:
        """Removes what was kept: the whole is written."""
        if self.work is not None:
            shutil.rmtree(self.work, ignore_errors=True)

    def _place(self, of_all: list[str], chunk: Folder) -> Path | None:
        """The chunk's file, named by all that its table depends on. of_all: what that of every chunk does."""
        if self.work is None:
            return None
        key = [*of_all, chunk.manifest.to_csv(), _files(chunk)]
        return self.work / f"{hashlib.sha256(json.dumps(key).encode()).hexdigest()[:24]}.parquet"


def _files(folder: Folder) -> list[Any]:
    """Size and time of change of each recording's files."""
    paths = [folder.root / file for file in folder.manifest["file"]]
    paths += [truth_path(path) for path in paths]
    return [[each.st_size, each.st_mtime_ns] for each in (path.stat() for path in paths if path.exists())]

"""A solve's finished lines on disk, so that an interrupted solve resumes."""

import hashlib
import json
import os
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from softslide.pipeline.skin.lines import Line
from softslide.pipeline.staging import writing

# Pressure level, depth level, line.
Task = tuple[int, int, Line]


# A line that cannot be kept is solved again where it is needed: the folder was removed in between each time.
ATTEMPTS = 3


class LineStore:
    """A folder of finished lines. A file appears under its name when it is whole.

    Several solves of one design may share it: what another one removes, when it ends first, is written anew.
    """

    def __init__(self, folder: Path, key: Any) -> None:
        """`key`: what the lines depend on, as JSON takes it; other keys' lines are not found.

        Raises:
            InputError: the folder cannot be made.
        """
        text = json.dumps(key, sort_keys=True)
        self._folder = folder / hashlib.sha256(text.encode()).hexdigest()[:16]
        with writing(folder, "name another place"):
            self._folder.mkdir(parents=True, exist_ok=True)

    def _path(self, task: Task) -> Path:
        level, depth, line = task
        return self._folder / f"{level}-{depth}-{line.name}.npz"

    def finished(self, tasks: list[Task]) -> dict[Task, tuple[np.ndarray, dict[str, float]]]:
        found = {}
        for task in tasks:
            with (
                suppress(FileNotFoundError),
                np.load(self._path(task), allow_pickle=False) as file,
            ):
                found[task] = (file["values"], json.loads(str(file["statistics"])))
        return found

    def keep(self, task: Task, values: np.ndarray, statistics: dict[str, float]) -> None:
        path = self._path(task)
        for _ in range(ATTEMPTS):
            with suppress(FileNotFoundError):
                self._folder.mkdir(parents=True, exist_ok=True)
                scratch = path.with_suffix(f".{os.getpid()}.partial.npz")
                np.savez(scratch, values=values, statistics=np.array(json.dumps(statistics)))
                scratch.replace(path)
                return

    def remove(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        # Another design's lines may be next to it, or another solve may have been first.
        with suppress(OSError):
            self._folder.parent.rmdir()

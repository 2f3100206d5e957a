"""A solve's finished lines on disk, so that an interrupted solve resumes."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from features.errors import InputError
from pipeline.skin.lines import Line

# Pressure level, depth level, line.
Task = tuple[int, int, Line]


class LineStore:
    """A folder of finished lines. A file appears under its name when it is whole."""

    def __init__(self, folder: Path, key: Any) -> None:
        """`key`: what the lines depend on, as JSON takes it; other keys' lines are not found.

        Raises:
            InputError: the folder cannot be made.
        """
        text = json.dumps(key, sort_keys=True)
        self._folder = folder / hashlib.sha256(text.encode()).hexdigest()[:16]
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written ({error.strerror}); name another place") from None

    def _path(self, task: Task) -> Path:
        level, depth, line = task
        return self._folder / f"{level}-{depth}-{line.name}.npz"

    def finished(self, tasks: list[Task]) -> dict[Task, tuple[np.ndarray, dict[str, float]]]:
        found = {}
        for task in tasks:
            if self._path(task).exists():
                with np.load(self._path(task), allow_pickle=False) as file:
                    found[task] = (file["values"], json.loads(str(file["statistics"])))
        return found

    def keep(self, task: Task, values: np.ndarray, statistics: dict[str, float]) -> None:
        path = self._path(task)
        scratch = path.with_suffix(".partial.npz")
        np.savez(scratch, values=values, statistics=np.array(json.dumps(statistics)))
        scratch.replace(path)

    def remove(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        if not any(self._folder.parent.iterdir()):
            self._folder.parent.rmdir()

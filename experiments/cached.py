"""Arrays that are kept in a folder for the next call that would compute the same, each set in a file named by its key.

Files are written whole or not at all, whoever else writes them. Where they cannot be written, nothing is kept.
"""

import hashlib
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

Arrays = dict[str, np.ndarray]


def cached(
    folder: Path | None,
    key: Any,
    make: Callable[[], Arrays],
    *,
    most: int | None = None,
    fresh: bool = False,
    taken: Callable[[Path], None] = lambda place: None,
) -> Arrays:
    """What `make` returns, or what an earlier call with this key kept of it in the folder; the same to the bit.

    folder: None: nothing is kept. key: all that the arrays depend on, as JSON takes it. most: files, beyond which those
    that were used longest ago are removed. fresh: makes them in any case. taken: called with the file that is read.
    """
    if folder is None:
        return make()
    place = folder / f"{hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:32]}.npz"
    arrays = None if fresh else _read(place)
    if arrays is not None:
        taken(place)
        if most is not None:
            os.utime(place)
        return arrays
    arrays = make()
    try:
        _write(place, arrays)
        for old in sorted(folder.iterdir(), key=lambda path: path.stat().st_mtime)[: -most if most else 0]:
            old.unlink(missing_ok=True)
    except OSError:
        pass
    return arrays


def cached_table(folder: Path | None, key: Any, make: Callable[[], pd.DataFrame]) -> pd.DataFrame:
    """`cached` for a table of numbers and texts, with its rows numbered."""

    def columns() -> Arrays:
        made = {str(name): column.to_numpy() for name, column in make().items()}
        return {
            name: values.astype(str) if values.dtype.kind == "O" else values for name, values in made.items()
        }

    return pd.DataFrame(cached(folder, key, columns))


def _read(place: Path) -> Arrays | None:
    """What is kept there; None where there is nothing, or a file that is damaged."""
    try:
        with np.load(place, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        return None


def _write(place: Path, arrays: Arrays) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    scratch = place.with_name(f"{place.stem}-{os.getpid()}.partial")
    try:
        with scratch.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]
        scratch.replace(place)
    finally:
        scratch.unlink(missing_ok=True)

"""HDF5: datasets by their path, a column of a two-dimensional one as `path:column`."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import Chunk, in_chunks, require


def read_hdf5(path: Path, columns: Sequence[str], matlab: bool = False) -> Iterator[Chunk]:
    """Columns `group/dataset` (n,), or `group/dataset:2` for column 2, counted from 0, of an (n, c) dataset.

    A dataset of one value stands for every sample. matlab: arrays are stored transposed (column-major), and
    `a.b` names field b of the struct a.
    """
    with h5py.File(path, "r") as file:
        names = {column: column.rpartition(":")[0] or column for column in columns}
        if matlab:
            names = {column: name.replace(".", "/") for column, name in names.items()}
        present: list[str] = []
        file.visititems(lambda name, item: present.append(name) if isinstance(item, h5py.Dataset) else None)
        require(path, [name.strip("/") for name in names.values()], present, "dataset")
        lanes = {column: _lane(path, file[name], column, matlab) for column, name in names.items()}
        yield from in_chunks(path, lanes)


class _Lane:
    """One column inside a dataset of two dimensions, along the axis that is time."""

    def __init__(self, dataset: h5py.Dataset, column: int, axis: int) -> None:
        self.dataset, self.column, self.axis = dataset, column, axis

    def __len__(self) -> int:
        return int(self.dataset.shape[self.axis])

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.dataset[rows, self.column] if self.axis == 0 else self.dataset[self.column, rows]


def _lane(path: Path, dataset: h5py.Dataset, column: str, matlab: bool) -> Any:
    """The column, to be sliced; finds which axis of the dataset is time."""
    if dataset.external or dataset.is_virtual:
        raise InputError(f"{path}: '{column}' lies in other files; copy it into one of its own (h5repack)")
    number = column.rpartition(":")[2] if ":" in column else ""
    if dataset.ndim > 2:
        raise InputError(f"{path}: '{column}' has {dataset.ndim} dimensions; name one of one or two")
    axis = 1 if matlab and dataset.ndim == 2 else 0
    if number:
        width = dataset.shape[1 - axis] if dataset.ndim == 2 else 1
        if not number.isdigit() or int(number) >= width:
            raise InputError(f"{path}: '{column}' has columns 0 to {width - 1}; name one of them")
    elif dataset.ndim == 2:
        if 1 not in dataset.shape:
            raise InputError(
                f"{path}: '{column}' has {dataset.shape[1 - axis]} columns; add ':0' for the first"
            )
        axis = int(np.argmax(dataset.shape))
    if not dataset.shape or dataset.shape[axis] == 1:
        value = np.asarray(dataset[()]).reshape(-1)[int(number or 0)]
        return np.array([value.decode() if isinstance(value, bytes) else value])
    return _Lane(dataset, int(number or 0), axis) if dataset.ndim == 2 else dataset

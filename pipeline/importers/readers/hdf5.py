"""HDF5: datasets by their path, a column of a two-dimensional one as `path:column`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import (
    MOST_CHUNK_BYTES,
    Chunk,
    check_length,
    in_chunks,
    require,
)

# Of one value: a number, or a label's text.
MOST_VALUE_BYTES = 4096
# gzip makes nothing smaller than 1,032 times; where more than this is missing, it was never written.
MOST_PACKED = 2000


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
    _check_size(path, dataset, column)
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
    lane = _Lane(dataset, int(number or 0), axis) if dataset.ndim == 2 else dataset
    if dataset.ndim and len(lane) > 1:
        return lane
    # The one value alone: the other axis may have any length.
    value = np.ravel(lane[:1] if dataset.ndim else dataset[()])[0]
    return np.array([value.decode() if isinstance(value, bytes) else value])


def _check_size(path: Path, dataset: h5py.Dataset, column: str) -> None:
    """Sees what a dataset says of its size, before any of it is read.

    Raises:
        InputError: a value or a chunk is too large, it has more samples than a recording, or most of it was never
            written.
    """
    value_bytes, stored_bytes = dataset.dtype.itemsize, dataset.id.get_storage_size()
    if value_bytes > MOST_VALUE_BYTES:
        raise InputError(f"{path}: '{column}' has values of {value_bytes} bytes; name a dataset of numbers")
    check_length(path, max(dataset.shape, default=1))
    chunk_bytes = math.prod(dataset.chunks or ()) * value_bytes
    if chunk_bytes > MOST_CHUNK_BYTES:
        raise InputError(
            f"{path}: '{column}' is in chunks of {chunk_bytes / 1e6:.3g} MB, and {MOST_CHUNK_BYTES / 1e6:.3g} at most "
            "are read; write it in smaller ones (h5repack -l)"
        )
    whole_bytes = dataset.size * value_bytes
    if whole_bytes > MOST_CHUNK_BYTES and stored_bytes * MOST_PACKED < whole_bytes:
        raise InputError(
            f"{path}: '{column}' stores {stored_bytes} bytes for {whole_bytes / 1e6:.3g} MB, so most of it was never "
            "written; record it again, or copy what was written into a dataset of its own"
        )

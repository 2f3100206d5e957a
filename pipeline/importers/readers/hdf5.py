"""HDF5: datasets by their path, a column of a two-dimensional one as `path:column`."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import h5py

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import (
    MOST_CHUNK_BYTES,
    Chunk,
    check_length,
    in_chunks,
    lane_of,
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
        lanes = {}
        for column, name in names.items():
            dataset = file[name]
            _check_dataset(path, dataset, column)
            lanes[column] = lane_of(path, dataset, column, axis=int(matlab))
        yield from in_chunks(path, lanes)


def _check_dataset(path: Path, dataset: h5py.Dataset, column: str) -> None:
    """Sees where a dataset lies and what it says of its size, before any of it is read.

    Raises:
        InputError: it lies elsewhere, a value or a chunk is too large, it has more samples than a recording, or most of
            it was never written.
    """
    if dataset.external or dataset.is_virtual:
        raise InputError(f"{path}: '{column}' lies in other files; copy it into one of its own (h5repack)")
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

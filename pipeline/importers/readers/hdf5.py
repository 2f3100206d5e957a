"""HDF5: datasets by their path, a column of a two-dimensional one as `path:column`."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import h5py
import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import Chunk, blocks, require


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
        length = common_length(path, {column: lane.length for column, lane in lanes.items()})
        for start, stop in blocks(length):
            yield Chunk({column: lane.read(start, stop) for column, lane in lanes.items()}, stop / length)


def common_length(path: Path, lengths: dict[str, int]) -> int:
    """The number of samples that all columns share; columns of one value aside.

    Raises:
        InputError: they differ.
    """
    longer = {column: length for column, length in lengths.items() if length != 1}
    if len(set(longer.values())) > 1:
        text = ", ".join(f"{column} {length}" for column, length in longer.items())
        raise InputError(f"{path}: columns differ in length ({text}); map columns of one recording")
    return next(iter(longer.values()), 1)


class _Lane:
    """One column inside a dataset of one or two dimensions."""

    def __init__(self, dataset: h5py.Dataset, column: int, axis: int) -> None:
        self.dataset, self.column, self.axis = dataset, column, axis
        self.length = int(dataset.shape[axis]) if dataset.shape else 1

    def read(self, start: int, stop: int) -> np.ndarray:
        """Samples [start, stop), (n,)."""
        if self.length == 1:
            value = np.asarray(self.dataset[()]).reshape(-1)[0]
            return np.full(stop - start, value.decode() if isinstance(value, bytes) else value)
        if self.dataset.ndim == 1:
            return self.dataset[start:stop]
        if self.axis == 0:
            return self.dataset[start:stop, self.column]
        return self.dataset[self.column, start:stop]


def _lane(path: Path, dataset: h5py.Dataset, column: str, matlab: bool) -> _Lane:
    """Finds which axis of the dataset is time."""
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
        return _Lane(dataset, int(number), axis)
    if dataset.ndim == 2:
        if 1 not in dataset.shape:
            raise InputError(
                f"{path}: '{column}' has {dataset.shape[1 - axis]} columns; add ':0' for the first"
            )
        axis = int(np.argmax(dataset.shape))
    return _Lane(dataset, 0, axis)

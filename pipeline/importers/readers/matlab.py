"""MATLAB .mat of both kinds: version 5 to 7 through SciPy, version 7.3 (HDF5) through h5py."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import Chunk, in_chunks, lane_of, require
from softslide.pipeline.importers.readers.hdf5 import read_hdf5

# Three hours of three channels at 1 kHz. A cell array takes some twenty times its bytes in memory.
MOST_UNPACKED_BYTES = 256 << 20
COMPRESSED = 15  # the type of an element (MAT-File Format, table 1-1)
PIECE_BYTES = 1 << 20


def read_matlab(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Columns `variable`, `variable:2` (column 2, counted from 0) or `struct.field`.

    Version 7.3 streams. The older kind cannot: a variable is read whole; only the variables that the map names are.
    """
    with path.open("rb") as file:
        head = file.read(128)
    if b"MATLAB 7.3" in head or head.startswith(b"\x89HDF"):
        yield from read_hdf5(path, columns, matlab=True)
        return
    _check_size(path, head)
    variables = {column.partition(":")[0].partition(".")[0] for column in columns}
    require(path, sorted(variables), [name for name, _, _ in scipy.io.whosmat(path)], "variable")
    content = scipy.io.loadmat(path, variable_names=variables, struct_as_record=False, squeeze_me=True)
    yield from in_chunks(path, {column: _column(path, content, column) for column in columns})


def _check_size(path: Path, head: bytes) -> None:
    """Unpacks what is compressed, a piece at a time, and keeps none. head: the file's first 128 bytes."""
    if 0 in head[:4]:  # version 4, which compresses nothing
        return
    unpacked, order = 0, "<" if head[126:] == b"IM" else ">"
    with path.open("rb") as file:
        file.seek(len(head))
        while len(tag := file.read(8)) == 8 and unpacked <= MOST_UNPACKED_BYTES:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                file.seek(size, 1)
                continue
            stream = zlib.decompressobj()
            for begin in range(0, size, PIECE_BYTES):
                piece = file.read(min(PIECE_BYTES, size - begin))
                while piece and unpacked <= MOST_UNPACKED_BYTES:
                    unpacked += len(stream.decompress(piece, PIECE_BYTES))
                    piece = stream.unconsumed_tail
    if unpacked > MOST_UNPACKED_BYTES:
        raise InputError(
            f"{path}: unpacks to more than {MOST_UNPACKED_BYTES / 1e6:.3g} MB; save the variables that the map names "
            "with -v7.3"
        )


def _column(path: Path, content: dict[str, Any], column: str) -> Any:
    variable, *fields = column.partition(":")[0].split(".")
    value = content[variable]
    for field in fields:
        if not hasattr(value, field):
            raise InputError(f"{path}: '{variable}' has no field '{field}'; correct its name in the map")
        value = getattr(value, field)
    return lane_of(path, np.atleast_1d(value), column)

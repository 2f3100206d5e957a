"""What every reader yields: successive samples of the columns asked for, as the file holds them."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from softslide.features.errors import InputError
from softslide.features.recording_file import MOST_SAMPLES

# Samples a chunk holds: some tens of MB for a dozen columns, so that memory does not grow with the file.
CHUNK = 200_000
# Of a file's own chunk, which is unpacked whole whatever is read of it; writers make them of 1 to 8 MB.
MOST_CHUNK_BYTES = 64 << 20


@dataclass(frozen=True)
class Chunk:
    """columns: name -> (n,), in the file's own type. done: the portion of the file read so far, 0 to 1."""

    columns: dict[str, np.ndarray]
    done: float

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def guarded(path: Path, kind: str, chunks: Iterator[Chunk]) -> Iterator[Chunk]:
    """The chunks of a reader, with whatever a broken file makes its library raise turned into one line.

    Libraries that parse bytes raise anything on bytes that are broken (struct.error, KeyError, OSError, ...),
    so nothing narrower than Exception is enough.
    """
    try:
        yield from chunks
    except (InputError, GeneratorExit):
        raise
    except Exception as error:
        if path.is_file() and path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty; copy or record it again") from error
        reason = " ".join(str(error).split())[:160] or type(error).__name__
        raise InputError(f"{path}: not a readable {kind} file ({reason}); copy or record it again") from error


def require(path: Path, columns: Sequence[str], present: Iterable[str], what: str = "column") -> None:
    """Sees that the file has what the map names.

    Raises:
        InputError: one is missing.
    """
    present = list(present)
    for column in columns:
        if column not in present:
            has = ", ".join(present[:12]) + (", ..." if len(present) > 12 else "")
            raise InputError(f"{path}: no {what} '{column}' (it has {has}); correct its name in the map")


def check_length(path: Path, samples: int) -> None:
    """Sees that a file says no more samples than a recording may have: few bytes can stand for any number of them.

    Raises:
        InputError: it says more.
    """
    if samples > MOST_SAMPLES:
        raise InputError(
            f"{path}: says it holds {samples} samples; {MOST_SAMPLES} at most are read: record shorter, or copy it "
            "again"
        )


def in_chunks(path: Path, lanes: Mapping[str, Any]) -> Iterator[Chunk]:
    """Chunks of columns that have a length and are sliced as arrays are; a column of one value stands for every sample.

    Raises:
        InputError: their lengths differ, or are more than a recording may have.
    """
    longer = {column: len(lane) for column, lane in lanes.items() if len(lane) != 1}
    if len(set(longer.values())) > 1:
        text = ", ".join(f"{column} {length}" for column, length in longer.items())
        raise InputError(f"{path}: columns differ in length ({text}); map columns of one recording")
    length = next(iter(longer.values()), 1)
    check_length(path, length)
    for start in range(0, length, CHUNK):
        stop = min(start + CHUNK, length)
        parts = {
            column: lane[start:stop] if len(lane) > 1 else np.repeat(lane[:], stop - start)
            for column, lane in lanes.items()
        }
        yield Chunk(parts, stop / length)


class _Lane:
    """One column of an array of two dimensions, along the axis that is time."""

    def __init__(self, array: Any, column: int, axis: int) -> None:
        self.array, self.column, self.axis = array, column, axis

    def __len__(self) -> int:
        return int(self.array.shape[self.axis])

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self.array[rows, self.column] if self.axis == 0 else self.array[self.column, rows]


def lane_of(path: Path, array: Any, column: str, axis: int = 0) -> Any:
    """What the map names of an array or a dataset, for `in_chunks`: `NAME` (n,), or `NAME:2` for column 2, counted from
    0, of two dimensions. axis: of these, which is time.

    Raises:
        InputError: it has more dimensions, no such column, or several where none is named.
    """
    number = column.rpartition(":")[2] if ":" in column else ""
    if array.ndim > 2:
        raise InputError(f"{path}: '{column}' has {array.ndim} dimensions; name one of one or two")
    if number:
        width = array.shape[1 - axis] if array.ndim == 2 else 1
        if not number.isdigit() or int(number) >= width:
            raise InputError(f"{path}: '{column}' has columns 0 to {width - 1}; name one of them")
    elif array.ndim == 2:
        if 1 not in array.shape:
            raise InputError(
                f"{path}: '{column}' has {array.shape[1 - axis]} columns; add ':0' for the first"
            )
        axis = int(np.argmax(array.shape))
    lane = _Lane(array, int(number or 0), axis) if array.ndim == 2 else array
    if array.ndim and len(lane) != 1:
        return lane
    # The one value alone: the other axis may have any length.
    value = np.ravel(lane[:] if array.ndim else array[()])[0]
    return np.array([value.decode() if isinstance(value, bytes) else value])


def chunks_of(
    path: Path, topic: str, columns: Sequence[str], rows: Iterable[list[Any]], total: int, size: int
) -> Iterator[Chunk]:
    """Chunks of `size` messages, from a row of cells for each.

    Raises:
        InputError: there are not as many as the file says, or a cell is a list.
    """
    rows, done = iter(rows), 0
    while block := list(islice(rows, size)):
        done += len(block)
        lanes = {name: np.array(lane) for name, lane in zip(columns, zip(*block, strict=True), strict=True)}
        if lists := [name for name, lane in lanes.items() if lane.ndim > 1]:
            raise InputError(
                f"{path}: '{lists[0]}' holds many values a message; name one that holds a number"
            )
        yield Chunk(lanes, done / total)
    if done != total:
        raise InputError(
            f"{path}: {done} of {total} messages on {topic}; the file is cut short: copy it again"
        )

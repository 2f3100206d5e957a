"""MCAP of JSON messages, as `softslide serve --log` writes it: a topic's fields by their names."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk as Packed
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import CHUNK, MOST_CHUNK_BYTES, Chunk, chunks_of, require

TOPIC = "/softslide/volts"
RECORD_HEAD_BYTES = 9  # of each record: its kind and its length


def read_mcap(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Fields of the messages on TOPIC, in the order of their times; null comes as NaN.

    Raises:
        InputError: no end, no such topic or field, or a chunk that unpacks to more than any.
    """
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise InputError(f"{path}: has no end, so that it may be cut short; close it, or copy it again")
        check_chunks(path, file, summary)
        require(path, [TOPIC], [channel.topic for channel in summary.channels.values()], "topic")
        (channel,) = (n for n, each in summary.channels.items() if each.topic == TOPIC)
        total = summary.statistics.channel_message_counts[channel]
        messages = (json.loads(message.data) for _, _, message in reader.iter_messages(topics=[TOPIC]))
        rows = (_cells(path, fields, columns) for fields in messages)
        yield from chunks_of(path, TOPIC, columns, rows, total, CHUNK)


def _cells(path: Path, fields: dict[str, Any], columns: Sequence[str]) -> list[Any]:
    require(path, columns, fields, "field")
    return [np.nan if fields[column] is None else fields[column] for column in columns]


def check_chunks(path: Path, file: BinaryIO, summary: Summary | None) -> None:
    """Sees what every chunk unpacks to, before one is unpacked. summary: the file's own; None: it has none.

    Raises:
        InputError: one unpacks to more than any.
    """
    for chunk in _chunks(file, summary):
        if (size := _unpacked_bytes(chunk)) > MOST_CHUNK_BYTES:
            raise InputError(
                f"{path}: a chunk unpacks to {size / 1e6:.3g} MB, and {MOST_CHUNK_BYTES / 1e6:.3g} at most are read; "
                "write it in smaller chunks"
            )


def _chunks(file: BinaryIO, summary: Summary | None) -> Iterator[Packed]:
    """The chunks that a reader unpacks: those of the index, or of the whole file where it has none."""
    if summary is not None and summary.chunk_indexes:
        for index in summary.chunk_indexes:
            file.seek(index.chunk_start_offset + RECORD_HEAD_BYTES)
            yield Packed.read(ReadDataStream(file))
    else:
        file.seek(0)
        yield from (each for each in StreamReader(file, emit_chunks=True).records if isinstance(each, Packed))


def _unpacked_bytes(chunk: Packed) -> int:
    """What a chunk unpacks to, or for LZ4 as much of it as is too much. What the chunk says need not be so."""
    if chunk.compression == "zstd":
        # Unpacked to what the frame says, and where it says nothing (-1) to what the chunk says.
        return max(zstandard.frame_content_size(chunk.data), chunk.uncompressed_size)
    if chunk.compression == "lz4":
        # Unpacked here and once more to be read, which takes a thirtieth of the time that its JSON does.
        return len(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, MOST_CHUNK_BYTES + 1))
    return len(chunk.data)

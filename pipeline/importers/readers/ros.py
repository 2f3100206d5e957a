"""ROS 1 bags, ROS 2 bags and MCAP, through rosbags: fields as `/topic.field.field` or `/topic.data[0]`."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import Chunk, chunks_of, require
from softslide.pipeline.importers.readers.mcap_log import check_chunks

# Messages a chunk holds: they are Python objects while they are read.
MESSAGES = 20_000
# As a time column, next to a message's own stamp: when the bag received it.
RECEIVED = "received"


def read_ros(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Fields of one topic's messages in the bag's order; stamps come as whole nanoseconds (int64).

    path: a `.bag`, an `.mcap`, a `.db3`, or the folder of a ROS 2 bag.
    """
    topic = columns[0].partition(".")[0]  # a ROS name holds no dot
    readers = [_field(path, column) for column in columns]
    for part in sorted(path.glob("*.mcap")) if path.is_dir() else [path] if path.suffix == ".mcap" else []:
        with part.open("rb") as file:
            check_chunks(part, file, make_reader(file).get_summary())
    # Bags recorded before message definitions were stored need the common ones.
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        require(path, [topic], sorted({connection.topic for connection in bag.connections}), "topic")
        connections = [connection for connection in bag.connections if connection.topic == topic]
        total = sum(connection.msgcount for connection in connections)
        messages = (
            (bag.deserialize(raw, connection.msgtype), received)
            for connection, received, raw in bag.messages(connections)
        )
        rows = ([read(message, received) for read in readers] for message, received in messages)
        yield from chunks_of(path, topic, columns, rows, total, MESSAGES)


def _field(path: Path, column: str) -> Callable[[object, int], float | int]:
    """How to read one field from a message: attribute by attribute, `[n]` for an array's element."""
    steps = re.findall(r"\.(\w+)|\[(\d+)\]", column.partition(".")[1] + column.partition(".")[2])
    if steps == [(RECEIVED, "")]:
        return lambda message, received: received

    def read(message, received: int) -> float | int:
        value = message
        for name, number in steps:
            try:
                value = getattr(value, name) if name else value[int(number)]
            except (AttributeError, IndexError):
                kind = type(message).__name__
                raise InputError(f"{path}: a {kind} has no '{column}'; correct its name in the map") from None
        if hasattr(value, "nanosec"):
            return value.sec * 1_000_000_000 + value.nanosec
        return value

    return read

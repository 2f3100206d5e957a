"""MCAP of JSON messages, as `softslide serve --log` writes it: a topic's fields by their names."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from softslide.features.errors import InputError
from softslide.pipeline.importers.readers.chunk import CHUNK, Chunk, require

TOPIC = "/softslide/volts"


def read_mcap(path: Path, columns: Sequence[str]) -> Iterator[Chunk]:
    """Fields of the messages on TOPIC, in the order of their times; null comes as NaN."""
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise InputError(f"{path}: has no end, so that it may be cut short; close it, or copy it again")
        require(path, [TOPIC], [channel.topic for channel in summary.channels.values()], "topic")
        (channel,) = (n for n, each in summary.channels.items() if each.topic == TOPIC)
        total = summary.statistics.channel_message_counts[channel]
        rows: list[list[float]] = []
        for done, (_, _, message) in enumerate(reader.iter_messages(topics=[TOPIC]), 1):
            fields = json.loads(message.data)
            require(path, columns, fields, "field")
            rows.append([np.nan if fields[column] is None else fields[column] for column in columns])
            if len(rows) == CHUNK or done == total:
                yield Chunk(dict(zip(columns, np.array(rows).T, strict=True)), done / total)
                rows = []

"""A stream kept as MCAP: the volts that came and the estimates that went out, as JSON with their schemas.

Foxglove and Rerun open such a file, and `softslide import` reads its volts (kind = "mcap").
"""

import json
import time
from pathlib import Path

import numpy as np
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer

from softslide.features.card import Card
from softslide.features.errors import InputError
from softslide.features.estimate import RECORDED, Estimate
from softslide.serve.records import record
from softslide.serve.stream.sources import Source

VOLTS, ESTIMATES = "/softslide/volts", "/softslide/estimate"
# Of the fields of an estimate; what is not listed is a number or null.
TYPES = {"state": "string", "contact": "string", "reason": "string", "valid": "boolean", "places": "array"}


class Log:
    """An MCAP file: a sink of estimates that also keeps the samples which a source passes through it.

    A message is logged at its own time: the moment of opening plus `time_s`.

    Raises:
        InputError: there is such a file already, or it cannot be written.
    """

    def __init__(self, path: Path, card: Card) -> None:
        self._columns, self._rate_hz, self._samples = card.columns, card.sample_rate_hz, 0
        try:
            self._file = path.open("xb")
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); name a new file", "log"
            ) from None
        self._writer = Writer(self._file)
        self._writer.start(library="softslide")
        self._begin_ns = time.time_ns()
        number = {"type": ["number", "null"]}
        volts = dict.fromkeys(("time_s", *self._columns), number)
        self._volts = self._channel(VOLTS, "softslide.Volts", volts)
        fields = {name: {"type": TYPES[name]} if name in TYPES else number for name in RECORDED}
        self._estimates = self._channel(ESTIMATES, "softslide.Estimate", fields)

    def passed(self, chunks: Source) -> Source:
        """The chunks, each kept on its way."""
        for chunk in chunks:
            if chunk:
                self._keep(*chunk)
            yield chunk

    def write(self, estimate: Estimate) -> None:
        """Keeps one estimate."""
        self._add(self._estimates, estimate.time_s, record(estimate))

    def close(self) -> None:
        """Writes the file's index."""
        self._writer.finish()
        self._file.close()

    def _keep(self, volts: np.ndarray, time_s: np.ndarray | None) -> None:
        if time_s is None:
            time_s = (self._samples + np.arange(len(volts))) / self._rate_hz
        self._samples += len(volts)
        for moment, row in zip(time_s.tolist(), volts.tolist(), strict=True):
            values = [value if np.isfinite(value) else None for value in row]
            self._add(
                self._volts, moment, {"time_s": moment, **dict(zip(self._columns, values, strict=True))}
            )

    def _channel(self, topic: str, name: str, fields: dict[str, dict]) -> int:
        schema = {"title": name, "type": "object", "properties": fields}
        text = json.dumps(schema).encode()
        kept = self._writer.register_schema(name=name, encoding=SchemaEncoding.JSONSchema, data=text)
        return self._writer.register_channel(topic, MessageEncoding.JSON, kept)

    def _add(self, channel: int, time_s: float, message: dict) -> None:
        at_ns = self._begin_ns + round(1e9 * time_s)
        data = json.dumps(message, allow_nan=False).encode()
        self._writer.add_message(channel, log_time=at_ns, data=data, publish_time=at_ns)

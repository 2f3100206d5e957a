"""The device at work: samples from a source, estimates to sinks, until the source ends or somebody stops it."""

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from features.errors import InputError
from serve.localizer import Localizer
from serve.sinks import Sink, open_sink
from serve.sources import open_source


def serve(bundle: Path, source: str, sinks: Sequence[str], form: str = "csv", fast: bool = False) -> int:
    """Streams until the source ends, or SIGINT or SIGTERM comes. Returns the number of estimates written.

    source, sinks: as in serve/sources.py and serve/sinks.py. form: of bytes from outside, csv or f32.
    fast: play a recording back as fast as it goes.

    Raises:
        InputError: the bundle, the source or a sink is not what it should be.
    """
    localizer = Localizer.load(bundle)
    opened: list[Sink] = []
    try:
        opened += [open_sink(name) for name in sinks]
        return _stream(localizer, source, opened, form, fast)
    finally:
        for sink in opened:
            sink.close()


def _stream(localizer: Localizer, source: str, sinks: Sequence[Sink], form: str, fast: bool) -> int:
    written = 0
    with _stoppable() as stopped:
        for chunk in open_source(source, localizer.card, form, fast):
            if stopped:
                break
            if not chunk:
                continue
            try:
                estimates = localizer.push(*chunk)
            except InputError as error:
                raise InputError(f"--source {source}: {error}") from None
            for estimate in estimates:
                for sink in sinks:
                    sink.write(estimate)
            written += len(estimates)
    return written


@contextmanager
def _stoppable() -> Iterator[list[int]]:
    """A list that is no longer empty once a signal asked to stop; a second one stops at once."""
    received: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        received.append(number)
        signal.signal(number, before[number])

    before: dict[int, Any] = {
        number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

"""`softslide serve`: from a source of samples to sinks and the page, until the source ends or a signal comes."""

import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from softslide.features.errors import InputError
from softslide.features.estimate import Estimate, Reason
from softslide.serve.files import read_for
from softslide.serve.localizer import Localizer
from softslide.serve.page.process import Page
from softslide.serve.stream.age import SampleAge
from softslide.serve.stream.framing import Chunk
from softslide.serve.stream.sinks import Sink, open_sink
from softslide.serve.stream.sources import WAIT_S, is_live, open_source, played


def serve(
    model: str | Path,
    source: str,
    sink: Sequence[str] | None = None,
    format: str = "csv",
    fast: bool = False,
    page: str | None = None,
    height_mm: float | None = None,
    unsigned: bool = False,
    log: str | Path | None = None,
    rate_hz: float | None = None,
    lag_s: float = 0.0,
) -> int:
    """Streams until the source ends, or SIGINT or SIGTERM comes. Returns the number of estimates written.

    While a live source gives nothing to estimate from, an estimate that is not valid (`no_signal`) is handed on each
    WAIT_S, whatever else comes.

    source, sink: as in serve/stream/sources.py and serve/stream/sinks.py. format: csv or f32, of bytes that come in.
    fast: play a recording as fast as possible. page: [HOST:]PORT of the live page, None for none.
    height_mm: the skin's, for a bundle over heights; None: as the static output shows it.
    unsigned: also a bundle whose card carries no hash of itself. log: an MCAP file to write (serve/stream/log.py).
    rate_hz: of a live source's samples; None: as in the bundle's calibration. A recording's own clock says it.
    lag_s: each moment's estimate comes so much later, from the samples since as well (`Localizer`).

    Raises:
        InputError: the bundle, the source, a sink or the page's address is wrong or cannot be opened.
    """
    live = is_live(source)
    localizer = Localizer.load(model, height_mm, unsigned, rate_hz if live else None, lag_s)
    if not live:
        volts, own_hz = read_for(Path(source), localizer.card)
        localizer = localizer.at_rate(own_hz)
    age = SampleAge() if live else None
    written, sink = 0, sink or ("-",)
    with _stoppable() as stopped, ExitStack() as held:
        waits = age is None or (len(sink) == 1 and page is None)
        opened = [held.enter_context(closing(open_sink(name, waits))) for name in sink]
        shown = None
        if page is not None:
            name = source if live else Path(source).name
            served = Page(page, localizer.card, name, Path(model), height_mm, unsigned)
            shown = held.enter_context(closing(served))
        chunks = open_source(source, localizer.card, format) if live else played(volts, localizer.card, fast)
        if log is not None:
            from softslide.serve.stream.log import Log

            kept = held.enter_context(closing(Log(Path(log), localizer.card)))
            chunks, opened = kept.passed(chunks), [*opened, kept]
        if shown is not None:
            print(f"softslide serve: the page is at {shown.address}", file=sys.stderr, flush=True)
        said_s = time.monotonic()  # when blocks were last complete, or were last said to be missing
        try:
            for chunk in chunks:
                if stopped:
                    break
                if shown is not None and shown.zero_wanted():
                    localizer.zero()
                before = localizer.blocks
                if chunk:
                    made = _estimates(localizer, chunk, age)
                    written += _hand_on(made, age, opened, shown)
                if localizer.blocks != before:
                    said_s = time.monotonic()
                # A source's wait may end a little early.
                elif age is not None and time.monotonic() - said_s > 0.9 * WAIT_S:
                    _without_signal(localizer, age, opened, shown)
                    said_s = time.monotonic()
            left = [(estimate, localizer.subtracted) for estimate in localizer.rest()]
            written += _hand_on(left, age, opened, shown)
        except InputError as error:
            if age is not None:
                _without_signal(localizer, age, opened, shown)
            raise InputError(f"{source}: {error}", "source") from None
    return written


Made = list[tuple[Estimate, np.ndarray]]


def _estimates(localizer: Localizer, chunk: Chunk, age: SampleAge | None) -> Made:
    """One chunk's estimates, each with the subtracted output (C,) V of its moment."""
    now_s = time.monotonic()
    made = [(estimate, localizer.subtracted) for estimate in localizer.each(*chunk)]
    if age is not None and made:
        age.came(made[-1][0].time_s, now_s)
    return made


def _hand_on(made: Made, age: SampleAge | None, sinks: Sequence[Sink], page: Page | None) -> int:
    """Hands estimates to the sinks and the page; returns their number."""
    now_s = time.monotonic()
    for estimate, subtracted in made:
        if age is not None:
            estimate = estimate._replace(age_s=age.of(estimate.time_s, now_s))
        for sink in sinks:
            sink.write(estimate)
        if page is not None:
            page.show(estimate, subtracted)
    return len(made)


def _without_signal(localizer: Localizer, age: SampleAge, sinks: Sequence[Sink], page: Page | None) -> None:
    """Hands on that no samples come: the last estimate, not valid, with the age of the newest sample."""
    last = localizer.read()
    silent = last._replace(valid=False, reason=Reason.NO_SIGNAL)
    _hand_on([(silent, localizer.subtracted)], age, sinks, page)


@contextmanager
def _stoppable() -> Iterator[list[int]]:
    """A list that a first SIGINT or SIGTERM fills, to stop in order; a second one stops the process at once."""
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

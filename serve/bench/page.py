"""Cost of the live page: share of a core, and delay of estimates and frames. Linux only.

A stream at rest comes in real time through standard input, its samples stamped with this computer's clock. An
estimate's time is that of its last sample, so that its delay is the time of reading, computing, writing and transfer.
"""

import json
import os
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np

from features.card import Card
from features.errors import InputError
from serve.localizer import Localizer

VIEWERS = (0, 1, 4)
# Blocks, 2 s, before measuring: the process starts and viewers connect.
WARM_UP = 100


def bench_page(bundle: Path, blocks: int = 300) -> dict[str, Any]:
    """Share of a core, and delays of estimates and frames in ms: without the page, and with 0, 1 and 4 viewers.

    Raises:
        InputError: the bundle cannot be opened, or the live extra is missing.
    """
    card = Localizer.load(bundle).card
    alone = _measured(bundle, card, blocks, None)
    return {"alone": alone, **{f"viewers_{n}": _measured(bundle, card, blocks, n) for n in VIEWERS}}


def _measured(bundle: Path, card: Card, blocks: int, viewers: int | None) -> dict[str, Any]:
    page = [] if viewers is None else ["--page", "0"]
    front = Path(__file__).parents[2] / "softslide.py"
    command = [sys.executable, str(front), "serve", "--model", str(bundle), "--source", "-", *page]
    estimates: list[float] = []
    frames: list[list[float]] = [[] for _ in range(viewers or 0)]
    with ExitStack() as held:
        running = held.enter_context(
            subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
        )
        assert running.stdin
        assert running.stdout
        assert running.stderr
        address = _address(running.stderr, viewers is not None)
        readers = [threading.Thread(target=_read, args=(running.stdout, estimates))]
        readers += [threading.Thread(target=_watch, args=(address, late)) for late in frames]
        for reader in readers:
            reader.start()
            held.callback(reader.join)
        pace = _feed(running.stdin, card)
        for _ in range(WARM_UP):
            next(pace)
        for late in (estimates, *frames):
            late.clear()
        begun, spent = time.monotonic(), _processor_s(running.pid)
        for _ in range(blocks):
            next(pace)
        seconds, spent = time.monotonic() - begun, _processor_s(running.pid) - spent
        result = {"core_share": round(spent / seconds, 4), "estimate_late": _ms(estimates)}
        if frames:
            result["frame_late"] = _ms([late for each in frames for late in each])
            result["frames_a_second"] = round(sum(map(len, frames)) / len(frames) / seconds, 1)
        running.stdin.close()
    return result


def _address(said: IO[str], page: bool) -> str:
    """Waits until the stream is open; returns the page's address, empty without a page."""
    for line in said:
        if "http://" in line:
            return line.split()[-1]
        if not page and "stop with" in line:
            return ""
        if "needs" in line:
            raise InputError(line.strip().partition(": ")[2])
    raise InputError("the stream did not start")


def _feed(stream: IO[str], card: Card) -> Iterator[None]:
    """Writes a block at rest whenever one is due."""
    size, rate = card.samples_per_block, card.sample_rate_hz
    zero = np.repeat([board["zero_g_v"] for board in card.sensor["accelerometers"]], 3)
    generator = np.random.default_rng(0)
    begun = time.monotonic()
    sample = 0
    while True:
        volts = zero + generator.normal(0.0, 0.005, (size, len(zero)))
        rows = np.column_stack([begun + np.arange(sample, sample + size) / rate, volts])
        text = "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist())
        sample += size
        time.sleep(max(0.0, begun + sample / rate - time.monotonic()))
        stream.write(text)
        stream.flush()
        yield


def _read(lines: IO[str], late: list[float]) -> None:
    for line in lines:
        late.append(time.monotonic() - json.loads(line)["time_s"])


def _watch(address: str, late: list[float]) -> None:
    """One viewer, until the stream ends."""
    from websockets.exceptions import ConnectionClosed
    from websockets.sync.client import connect

    with connect(f"{address.replace('http', 'ws', 1)}stream", proxy=None, compression=None) as view:
        view.recv()
        try:
            while True:
                view.send("")
                frame = view.recv()
                if frame:
                    late.append(time.monotonic() - struct.unpack_from("<d", frame)[0])  # type: ignore[arg-type]
        except ConnectionClosed:
            return


def _processor_s(process: int) -> float:
    """Processor time of a process so far, s."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _ms(seconds: list[float]) -> dict[str, float]:
    median, tail = np.quantile(seconds, [0.5, 0.99]) * 1e3
    return {"median_ms": round(float(median), 2), "p99_ms": round(float(tail), 2)}

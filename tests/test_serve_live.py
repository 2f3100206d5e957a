"""`softslide serve`: sources, sinks, framing, and how it ends."""

import json
import os
import pty
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from frames import frame
from sender import free_port
from served import repeated, started
from streams import RATE_HZ, pass_over, still, stream

import softslide
from softslide.features.errors import InputError
from softslide.serve.localizer import Localizer
from softslide.serve.records import record
from softslide.serve.stream.framing import framing_of
from softslide.serve.stream.sinks import open_sink

VOLTS = stream(still(0.6), pass_over(1.0), still(0.4))
TIME_S = np.arange(len(VOLTS)) / RATE_HZ
CSV = "".join(f"{t:.4f},{x!r},{y!r},{z!r}\n" for t, (x, y, z) in zip(TIME_S, VOLTS.tolist(), strict=True))


@pytest.fixture(scope="module")
def wanted(bundle: Path) -> list[dict]:
    return [record(estimate) for estimate in Localizer.load(bundle).push(VOLTS)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("recorded") / "a.csv"
    path.write_text("time_s,a0_vx,a0_vy,a0_vz\n" + CSV)
    return str(path)


def serve(bundle: Path, *options: str) -> int:
    return softslide.main(["serve", "--model", str(bundle), *options])


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def test_a_recorded_file_is_played(
    bundle: Path, wanted: list[dict], recorded: str, capsys: pytest.CaptureFixture
) -> None:
    assert serve(bundle, "--source", recorded, "--fast") == 0
    assert lines(capsys.readouterr().out) == wanted


@pytest.mark.parametrize(("form", "within_mm"), [("csv", 0.0), ("f32", 1e-4), ("cobs", 1e-4)])
def test_standard_input(bundle: Path, wanted: list[dict], form: str, within_mm: float) -> None:
    frames = b"".join(frame([t, *row]) for t, row in zip(TIME_S, VOLTS, strict=True))
    data = {"csv": CSV.encode(), "f32": VOLTS.astype("<f4").tobytes(), "cobs": frames}[form]
    out, _ = started(bundle, "-", "--format", form).communicate(data, timeout=60)
    found = lines(out.decode())
    assert len(found) == len(wanted)
    assert found[-1]["offset_mm"] == pytest.approx(wanted[-1]["offset_mm"], rel=0.0, abs=within_mm)


def test_datagrams_in_and_out_until_a_signal(bundle: Path, wanted: list[dict]) -> None:
    place = ("127.0.0.1", free_port())
    text = CSV.splitlines(keepends=True)
    datagrams = ["nonsense,1\n", *("".join(text[begin : begin + 20]) for begin in range(0, len(text), 20))]
    with (
        socket.socket(type=socket.SOCK_DGRAM) as ear,
        socket.socket(type=socket.SOCK_DGRAM) as mouth,
    ):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(30)
        sink = f"udp://127.0.0.1:{ear.getsockname()[1]}"
        running = started(bundle, f"udp://:{place[1]}", "--sink", sink)
        try:
            with repeated(lambda: [mouth.sendto(each.encode(), place) for each in datagrams]):
                found = json.loads(ear.recv(1 << 16))
        finally:
            running.send_signal(signal.SIGTERM)
            out, error = running.communicate(timeout=30)
    assert running.returncode == 0
    assert out == b""
    assert b"estimates" in error
    assert found.keys() == wanted[0].keys()


def test_a_broken_pipe_is_not_a_failure(bundle: Path) -> None:
    running = started(bundle, "-")
    assert running.stdin is not None
    assert running.stdout is not None
    running.stdin.write(CSV[: len(CSV) // 2].encode())
    running.stdin.flush()
    running.stdout.readline()
    running.stdout.close()
    with suppress(BrokenPipeError):
        running.stdin.write(CSV[len(CSV) // 2 :].encode())
        running.stdin.close()
    assert running.stderr is not None
    with running.stderr:
        error = running.stderr.read()
    assert running.wait(30) == 0
    assert b"Traceback" not in error


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_silent_stream(bundle: Path, number: signal.Signals) -> None:
    with started(bundle, "-") as running:
        assert running.stdin is not None
        assert running.stdout is not None
        running.stdin.write(CSV[:4000].encode())
        running.stdin.flush()
        running.stdout.readline()
        running.send_signal(number)
        assert running.wait(30) == 0


def test_a_serial_port(bundle: Path) -> None:
    pytest.importorskip("serial")
    ours, theirs = pty.openpty()
    said = b"5,1.7,1.6,2.4\n" + "".join(CSV.splitlines(keepends=True)[:50]).encode()
    try:
        with started(bundle, f"serial://{os.ttyname(theirs)}?115200") as running:
            assert running.stdout is not None
            try:
                with repeated(lambda: os.write(ours, said)):
                    assert json.loads(running.stdout.readline())["state"] == "rest"
            finally:
                running.send_signal(signal.SIGTERM)
            running.communicate(timeout=30)
            assert running.returncode == 0
    finally:
        os.close(ours)
        os.close(theirs)


SOURCES = (
    *("nothing.csv", "x" * 5000, "http://x", "udp://x", "udp://a..b:9000", "udp://203.0.113.1:9000"),
    *("serial:///dev/no-such-port", "serial:///dev/ttyS0?fast", "ros2://x", "ros2+imu://x"),
)
SINKS = ("udp://127.0.0.1", "udp://a..b:9000", "udp://127.0.0.1:\u00b2", "file.json", "ros2://x")


@pytest.mark.parametrize(("source", "sink"), [*((s, "") for s in SOURCES), *(("-", s) for s in SINKS)])
def test_bad_usage_is_an_error_of_one_line(
    bundle: Path, source: str, sink: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    assert serve(bundle, "--source", source, *(["--sink", sink] if sink else [])) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("softslide serve: ")
    assert ("rclpy is not here" in last) == ("ros2" in source + sink)


@pytest.mark.parametrize("size", [1, 7, 1000, 10**6])
def test_samples_do_not_depend_on_the_pieces_of_bytes(size: int) -> None:
    for form, data in (("csv", f"x,y,z\n{CSV.rstrip()}".encode()), ("f32", VOLTS.astype("<f4").tobytes())):
        framing = framing_of(form, 3)
        chunks = [c for begin in range(0, len(data), size) for c in framing.read(data[begin : begin + size])]
        chunks += framing.end()
        volts = np.concatenate([chunk for chunk, _ in chunks])
        assert volts == pytest.approx(VOLTS, abs=1e-6)
        if form == "csv":
            times = np.concatenate([times for _, times in chunks if times is not None])
            assert times == pytest.approx(TIME_S)


@pytest.mark.parametrize("line", ["1,2", "1,2,3,4,5", "1,a,3", "nan,1,2,3", "1,2,3,4\n1,2,3"])
def test_a_line_that_is_not_a_sample_is_refused_or_skipped(line: str) -> None:
    data = f"0,1,2,3\n{line}\n".encode() if "\n" not in line else f"{line}\n".encode()
    with pytest.raises(InputError, match="line 2"):
        list(framing_of("csv", 3).read(data))
    assert sum(len(volts) for volts, _ in framing_of("csv", 3, strict=False).read(data)) == 1


def test_an_empty_cell_is_a_lost_sample() -> None:
    ((volts, _),) = framing_of("csv", 3).read(b"1.0,,2.0\n")
    assert np.isnan(volts[0, 1])


def test_a_sink_that_cannot_be_reached_is_said_once(bundle: Path, capsys: pytest.CaptureFixture) -> None:
    """A broadcast is not permitted."""
    sink = open_sink("udp://255.255.255.255:9000")
    for estimate in Localizer.load(bundle).push(VOLTS)[:3]:
        sink.write(estimate)
    sink.close()
    assert capsys.readouterr().err.count("cannot be reached") == 1

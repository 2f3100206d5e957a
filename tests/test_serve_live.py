"""`softslide serve`: sources, sinks, framing, and how it ends."""

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from small_bundle import write_small_bundle
from streams import RATE_HZ, a_sensor, pass_over, still, stream

import softslide
from features.errors import InputError
from features.track_filter import TrackFilter
from serve.localizer import Localizer
from serve.records import record
from serve.stream.framing import framing_of

VOLTS = stream(still(0.6), pass_over(1.0), still(0.4))
TIME_S = np.arange(len(VOLTS)) / RATE_HZ
CSV = "".join(f"{t:.4f},{x!r},{y!r},{z!r}\n" for t, (x, y, z) in zip(TIME_S, VOLTS.tolist(), strict=True))


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles") / "one"
    return write_small_bundle(folder, a_sensor(), offset_mm_per_v=50.0)


@pytest.fixture(scope="module")
def wanted(bundle: Path) -> list[dict]:
    return [record(estimate) for estimate in Localizer.load(bundle).push(VOLTS)]


def command(bundle: Path, source: str, *more: str) -> list[str]:
    place = Path(softslide.__file__)
    return [sys.executable, str(place), "serve", "--model", str(bundle), "--source", source, *more]


def lines(text: str) -> list[dict]:
    return [json.loads(line) for line in text.splitlines()]


def test_a_recorded_file_is_played(
    bundle: Path, wanted: list[dict], tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "a.csv").write_text("time_s,a0_vx,a0_vy,a0_vz\n" + CSV)
    status = softslide.main(command(bundle, str(tmp_path / "a.csv"), "--fast")[2:])
    assert status == 0
    assert lines(capsys.readouterr().out) == wanted


def test_smoothed_estimates_are_those_of_the_track_filter(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    (tmp_path / "a.csv").write_text("time_s,a0_vx,a0_vy,a0_vz\n" + CSV)
    softslide.main([*command(bundle, str(tmp_path / "a.csv"), "--fast")[2:], "--smooth"])
    told, track = lines(capsys.readouterr().out), TrackFilter()
    assert told == [record(track.update(estimate)) for estimate in Localizer.load(bundle).push(VOLTS)]


@pytest.mark.parametrize("form", ["csv", "f32"])
def test_standard_input(bundle: Path, wanted: list[dict], form: str) -> None:
    data = CSV.encode() if form == "csv" else VOLTS.astype("<f4").tobytes()
    done = subprocess.run(
        command(bundle, "-", "--format", form), input=data, capture_output=True, check=True, timeout=60
    )
    told = lines(done.stdout.decode())
    assert len(told) == len(wanted)
    if form == "csv":
        assert told[-1]["offset_mm"] == wanted[-1]["offset_mm"]
    else:
        assert told[-1]["offset_mm"] == pytest.approx(wanted[-1]["offset_mm"], abs=1e-4)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def test_datagrams_in_and_out_until_a_signal(bundle: Path, wanted: list[dict]) -> None:
    port = free_port()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
        socket.socket(type=socket.SOCK_DGRAM) as mouth,
    ):
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(30)
        sink = f"udp://127.0.0.1:{ear.getsockname()[1]}"
        running = subprocess.Popen(
            command(bundle, f"udp://:{port}", "--sink", sink), stderr=subprocess.PIPE, stdout=subprocess.PIPE
        )
        told = []
        heard = threading.Event()

        def speak() -> None:
            text = CSV.splitlines(keepends=True)
            while not heard.wait(0.05):
                mouth.sendto(b"nonsense,1\n", ("127.0.0.1", port))
                for begin in range(0, len(text), 20):
                    mouth.sendto("".join(text[begin : begin + 20]).encode(), ("127.0.0.1", port))

        speaker = threading.Thread(target=speak)
        speaker.start()
        try:
            told.append(json.loads(ear.recv(1 << 16)))
        finally:
            heard.set()
            speaker.join()
            running.send_signal(signal.SIGTERM)
            out, error = running.communicate(timeout=30)
    assert running.returncode == 0
    assert out == b""
    assert b"estimates" in error
    assert told[0].keys() == wanted[0].keys()


def test_a_broken_pipe_is_no_failure(bundle: Path) -> None:
    running = subprocess.Popen(
        command(bundle, "-"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert running.stdin is not None
    assert running.stdout is not None
    running.stdin.write(CSV[: len(CSV) // 2].encode())
    running.stdin.flush()
    running.stdout.readline()
    running.stdout.close()
    try:
        running.stdin.write(CSV[len(CSV) // 2 :].encode())
        running.stdin.close()
    except BrokenPipeError:
        pass
    assert running.stderr is not None
    error = running.stderr.read()
    running.stderr.close()
    assert running.wait(30) == 0
    assert b"Traceback" not in error


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_silent_stream(bundle: Path, number: signal.Signals) -> None:
    with subprocess.Popen(
        command(bundle, "-"), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as running:
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
    try:
        with subprocess.Popen(
            command(bundle, f"serial://{os.ttyname(theirs)}?115200"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        ) as running:
            assert running.stdout is not None
            halt = threading.Event()

            def speak() -> None:
                while not halt.wait(0.05):
                    os.write(ours, b"5,1.7,1.6,2.4\n" + "".join(CSV.splitlines(keepends=True)[:50]).encode())

            speaker = threading.Thread(target=speak)
            speaker.start()
            try:
                assert json.loads(running.stdout.readline())["state"] == "rest"
            finally:
                halt.set()
                speaker.join()
                running.send_signal(signal.SIGTERM)
            running.communicate(timeout=30)
            assert running.returncode == 0
    finally:
        os.close(ours)
        os.close(theirs)


@pytest.mark.parametrize(
    "options",
    [
        ["--source", "nothing.csv"],
        ["--source", "http://x"],
        ["--source", "udp://x"],
        ["--source", "udp://203.0.113.1:9000"],
        ["--source", "serial:///dev/no-such-port"],
        ["--source", "serial:///dev/ttyS0?fast"],
        ["--source", "-", "--sink", "udp://127.0.0.1"],
        ["--source", "-", "--sink", "file.json"],
    ],
    ids=str,
)
def test_bad_usage_is_an_error_of_one_line(
    bundle: Path, options: list[str], capsys: pytest.CaptureFixture
) -> None:
    assert softslide.main(["serve", "--model", str(bundle), *options]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("softslide serve: ")


def test_ros_without_rclpy(
    bundle: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    sources = (["--source", "ros2://x"], ["--source", "ros2+imu://x"])
    for options in (*sources, ["--source", "-", "--sink", "ros2://x"]):
        assert softslide.main(["serve", "--model", str(bundle), *options]) == 2
        assert "rclpy is not here" in capsys.readouterr().err


@pytest.mark.parametrize("size", [1, 7, 1000, 10**6])
def test_samples_do_not_depend_on_the_pieces_of_bytes(size: int) -> None:
    for form, data in (("csv", ("x,y,z\n" + CSV.rstrip()).encode()), ("f32", VOLTS.astype("<f4").tobytes())):
        framing = framing_of(form, 3)
        chunks = [c for begin in range(0, len(data), size) for c in framing.read(data[begin : begin + size])]
        chunks += framing.end()
        volts = np.concatenate([chunk for chunk, _ in chunks])
        assert volts == pytest.approx(VOLTS, abs=1e-6)
        if form == "csv":
            times = np.concatenate([times for _, times in chunks if times is not None])
            assert times == pytest.approx(TIME_S)


@pytest.mark.parametrize("line", ["1,2", "1,2,3,4,5", "1,a,3", "nan,1,2,3", "1,2,3,4\n1,2,3"])
def test_a_line_that_is_no_sample_is_refused_or_skipped(line: str) -> None:
    data = f"0,1,2,3\n{line}\n".encode() if "\n" not in line else f"{line}\n".encode()
    with pytest.raises(InputError, match="line 2"):
        list(framing_of("csv", 3).read(data))
    assert sum(len(volts) for volts, _ in framing_of("csv", 3, strict=False).read(data)) == 1


def test_an_empty_cell_is_a_lost_sample() -> None:
    ((volts, _),) = framing_of("csv", 3).read(b"1.0,,2.0\n")
    assert np.isnan(volts[0, 1])

"""What a live stream says while no samples come, and how old it says that its samples are."""

import json
import signal
import socket
import subprocess
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from sender import free_port
from served import started
from streams import RATE_HZ
from test_serve_live import CSV

from softslide.serve.stream.age import MEMORY_S, SampleAge

LINES = CSV.splitlines(keepends=True)
HALF = round(1.1 * RATE_HZ)  # in mid-slide


def send(running: subprocess.Popen, lines: list[str]) -> None:
    running.stdin.write("".join(lines).encode())
    running.stdin.flush()


def test_a_cable_pulled_in_mid_slide_is_said_until_it_is_plugged_in_again(bundle: Path) -> None:
    with started(bundle, "-") as running:
        send(running, LINES[:HALF])
        live = [json.loads(running.stdout.readline()) for _ in range(HALF // 20)]
        silent = [json.loads(running.stdout.readline()) for _ in range(6)]
        send(running, LINES[HALF:])
        running.stdin.close()
        after = [json.loads(line) for line in running.stdout]
    assert live[-1]["state"] == "slide"
    assert live[-1]["reason"] != "no_signal"
    assert {(line["valid"], line["reason"]) for line in silent} == {(False, "no_signal")}
    assert {line["time_s"] for line in silent} == {live[-1]["time_s"]}
    ages = [line["age_s"] for line in silent]
    assert ages == sorted(ages)
    assert all(0.15 < step < 2.0 for step in np.diff([0.0, *ages]))
    resumed = [line for line in after if line["reason"] != "no_signal"]
    assert [line["time_s"] for line in resumed] == pytest.approx(np.arange(HALF // 20 + 1, 101) * 0.02)


def test_a_stream_without_a_new_sample_is_no_signal_whatever_else_comes(bundle: Path) -> None:
    """Over UDP in mid-slide: texts that are no samples, the last sample again and again, another sender."""
    port, seen = free_port(), list[tuple[float, dict]]()
    with (
        started(bundle, f"udp://127.0.0.1:{port}") as running,
        socket.socket(type=socket.SOCK_DGRAM) as sender,
    ):

        def read() -> None:
            seen.extend((time.monotonic(), json.loads(line)) for line in running.stdout)

        reader = threading.Thread(target=read)
        reader.start()
        while not seen:
            time.sleep(0.01)
        for n in range(0, HALF, 20):
            sender.sendto("".join(LINES[n : n + 20]).encode(), ("127.0.0.1", port))
            time.sleep(0.02)
        with socket.socket(type=socket.SOCK_DGRAM) as other:
            phases = [(sender, "sensor lost\n"), (sender, LINES[HALF - 1]), (other, LINES[HALF])]
            began = [time.monotonic()]
            for speaks, text in phases:
                while time.monotonic() < began[-1] + 0.7:
                    speaks.sendto(text.encode(), ("127.0.0.1", port))
                    time.sleep(0.02)
                began.append(time.monotonic())
        running.send_signal(signal.SIGTERM)
        reader.join()
    assert any(line["state"] == "slide" for _, line in seen)
    for begin, end in pairwise(began):
        said = [line for at, line in seen if begin + 0.1 < at < end]
        assert len(said) >= 2
        assert {(line["valid"], line["reason"]) for line in said} == {(False, "no_signal")}


def test_estimates_made_after_a_hold_up_do_not_look_fresh(bundle: Path) -> None:
    """The process stands still for 1 s while samples go on coming."""
    with started(bundle, "-") as running:
        began = time.monotonic()

        def speak() -> None:
            for n in range(0, len(LINES), 20):
                time.sleep(max(0.0, began + (n + 20) / RATE_HZ - time.monotonic()))
                send(running, LINES[n : n + 20])
            running.stdin.close()

        speaker = threading.Thread(target=speak)
        send(running, ["x\n"])
        running.stdout.readline()  # the process is up: nothing has come
        began = time.monotonic()
        speaker.start()
        time.sleep(0.7)
        running.send_signal(signal.SIGSTOP)
        time.sleep(1.0)
        running.send_signal(signal.SIGCONT)
        speaker.join()
        lines = [json.loads(line) for line in running.stdout]
    estimates = {line["time_s"]: line["age_s"] for line in lines if line["reason"] != "no_signal"}
    assert len(estimates) >= 100
    assert max(age for time_s, age in estimates.items() if time_s <= 0.6) < 0.3
    assert max(estimates.values()) > 0.6


def test_age_is_of_the_sample_that_waited_least() -> None:
    age = SampleAge()
    assert np.isnan(age.of(0.0, 0.0))
    for n in range(100):
        age.came(0.02 * n, 5.0 + 0.02 * n + 0.01 * (n % 3))
    assert age.of(1.98, 5.0 + 1.98) == 0.0
    assert age.of(1.98, 5.0 + 1.98 + 4.0) == 4.0
    # Time that runs back is another stream.
    age.came(0.0, 30.0)
    assert age.of(0.0, 30.5) == 0.5


def test_a_clock_that_runs_slow_is_not_an_age_for_ever() -> None:
    age = SampleAge()
    for n in range(5000):
        age.came(0.02 * n, 1.01 * 0.02 * n)
        assert age.of(0.02 * n, 1.01 * 0.02 * n) < 0.011 * MEMORY_S


@pytest.mark.parametrize("held_s", [4.0, 60.0])
def test_what_a_hold_up_kept_waiting_is_old(held_s: float) -> None:
    """Samples of a minute and then of the hold-up, which are read afterwards in a tenth of its time."""
    age = SampleAge()
    for n in range(3000):
        age.came(0.02 * n, 0.02 * n)
    for now_s in np.arange(60.0 + held_s, 60.0 + 1.1 * held_s, 0.05):
        sample_s = 60.0 + 10.0 * (now_s - 60.0 - held_s)
        age.came(sample_s, now_s)
        assert age.of(sample_s, now_s) == pytest.approx(now_s - sample_s, abs=0.01)


def test_standard_output_that_is_not_read_does_not_stop_the_other_sinks(bundle: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        other.settimeout(60.0)
        sinks = ["--sink", "-", "--sink", f"udp://127.0.0.1:{other.getsockname()[1]}"]
        with started(bundle, "-", *sinks) as running:
            send(running, LINES[:40])
            other.recv(1 << 16)
            for _ in range(5):
                send(running, LINES)
            # Beyond what a pipe holds, 64 kB, and never read.
            seen = [json.loads(other.recv(1 << 16)) for _ in range(400)]
            running.kill()
    assert sum(line["reason"] != "no_signal" for line in seen) > 300

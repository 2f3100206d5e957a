"""What a live stream says while no samples come, and how old it says that its samples are."""

import json
import signal
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from streams import RATE_HZ
from test_serve_live import CSV, started

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
    # A device's clock that runs slow is not mistaken for an age for ever.
    age.came(2.0, 8.0)
    age.came(2.02, 8.0 + MEMORY_S + 1.0)
    assert age.of(2.02, 8.0 + MEMORY_S + 1.0) == 0.0
    # Time that runs back is another stream.
    age.came(0.0, 30.0)
    assert age.of(0.0, 30.5) == 0.5


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

"""Workers on this computer end with the process that they work for."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parents[1]
PATIENCE_S = 300
WORKING = """
from operator import add
from softslide.pipeline.workers import results
for sum in results(add, ((n, 1) for n in iter(int, 1)), 2):
    print(sum, flush=True)
"""


def test_workers_end_with_a_process_that_is_killed() -> None:
    command = [sys.executable, "-c", WORKING]
    running = subprocess.Popen(
        command, cwd=HERE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
    )
    assert running.stdout is not None
    assert running.stdout.readline() == b"1\n"
    running.kill()
    running.communicate(timeout=PATIENCE_S)
    until = time.monotonic() + 60
    while time.monotonic() < until:
        try:
            os.killpg(running.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.1)
    os.killpg(running.pid, signal.SIGKILL)
    pytest.fail("workers outlive the process that they work for")

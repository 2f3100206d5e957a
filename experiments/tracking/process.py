"""The process that a run is of, as tags, and whether it is gone: a run whose process was killed never says its end."""

import os
import socket
from collections.abc import Mapping
from pathlib import Path

HOST, PROCESS = "host", "process"


def process_tags() -> dict[str, str]:
    """This process: its computer, and its identifier there with the moment that it started at, where that is told."""
    return {HOST: _host(), PROCESS: f"{os.getpid()} {_started(os.getpid())}".strip()}


def is_gone(tags: Mapping[str, str]) -> bool:
    """Whether the process that these tags name is of this computer and has ended; False where that is not certain."""
    identifier, _, started = tags.get(PROCESS, "").partition(" ")
    # On Windows os.kill would end the process that is asked for.
    if tags.get(HOST) != _host() or not identifier.isdigit() or os.name != "posix":
        return False
    try:
        os.kill(int(identifier), 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False  # somebody else's process
    # The identifier may have been given to another process since.
    return _started(int(identifier)) != started


def _host() -> str:
    """The computer's name, and on Linux which numbering of processes holds: containers have their own."""
    try:
        numbering = os.readlink("/proc/self/ns/pid")
    except OSError:
        numbering = ""
    return f"{socket.gethostname()} {numbering}".strip()


def _started(identifier: int) -> str:
    """When a process started, in ticks since the computer did; empty where that is not told."""
    try:
        line = Path(f"/proc/{identifier}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    # Fields are counted behind the name, which may hold blanks; starttime is the 22nd (proc(5)).
    return line.rpartition(")")[2].split()[19]

"""A team's tracking server: MLflow on PostgreSQL, on free ports of this machine, for as long as a block runs."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

# Much longer than either takes, since other tests run too.
PATIENCE_S = 120


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def binaries() -> Path | None:
    """Where PostgreSQL's programs are: Debian keeps each release's in a folder of their own; None: not installed."""
    if found := shutil.which("initdb"):
        return Path(found).parent
    releases = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda path: int(path.parts[-3]))
    return releases[-1].parent if releases else None


@contextmanager
def postgres() -> Iterator[str]:
    """A fresh database; its address for SQLAlchemy. PostgreSQL refuses to run as root: its own user does it then."""
    programs = binaries()
    assert programs is not None
    # Not below pytest's folder, which is for its own user's eyes alone.
    root = Path(tempfile.mkdtemp(prefix="softslide-postgres-"))
    user = ["runuser", "-u", "postgres", "--"] if os.getuid() == 0 else []
    if user:
        shutil.chown(root, "postgres")

    def run(*words: object) -> None:
        command = [*user, *map(str, words)]
        done = subprocess.run(
            command, cwd=root, timeout=PATIENCE_S, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        assert done.returncode == 0, done.stderr

    port, data = free_port(), root / "data"
    try:
        words = ["-U", "team", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync"]
        run(programs / "initdb", "-D", data, *words)
        options = f"-p {port} -k {root} -c listen_addresses=127.0.0.1 -c fsync=off"
        server = (programs / "pg_ctl", "-D", data)
        run(*server, "start", "-w", "-t", PATIENCE_S, "-l", root / "log", "-o", options)
        try:
            yield f"postgresql+psycopg://team@127.0.0.1:{port}/postgres"
        finally:
            run(*server, "stop", "-m", "immediate")
    finally:
        shutil.rmtree(root, ignore_errors=True)


@contextmanager
def mlflow_server(database: str, artifacts: Path, port: int) -> Iterator[str]:
    """The server on that database; its address. It is killed at the block's end."""
    words = ["--backend-store-uri", database, "--artifacts-destination", artifacts, "--host", "127.0.0.1"]
    command = [sys.executable, "-m", "mlflow", "server", *words, "--port", port, "--workers", 1]
    log = artifacts.parent / f"server-{port}.log"
    # It starts processes for jobs, which nothing here asks for.
    environment = {**os.environ, "MLFLOW_SERVER_ENABLE_JOB_EXECUTION": "false"}
    with log.open("ab") as out:
        running = subprocess.Popen(
            list(map(str, command)), stdout=out, stderr=out, env=environment, start_new_session=True
        )
    address = f"http://127.0.0.1:{port}"
    try:
        until = time.monotonic() + PATIENCE_S
        while not answers(f"{address}/health"):
            assert running.poll() is None, log.read_text()
            assert time.monotonic() < until, log.read_text()
            time.sleep(0.2)
        yield address
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait(PATIENCE_S)


def answers(address: str) -> bool:
    """Whether a server is there that says that all is well."""
    try:
        with urllib.request.urlopen(address, timeout=5) as answer:
            return answer.status == 200
    except OSError:
        return False

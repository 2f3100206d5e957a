"""Commands in processes of their own that start at once, to be killed midway or to find no space.

Run as a script it says its own identifier, and forks a process for each line that it reads, a JSON object with `words`
and `folder`, once it has loaded what the command needs. It answers with the process's identifier and, when that has
ended, with its exit status. The commands in its arguments are loaded at once.
"""

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

# Seconds after which a command, or what a killed one started, counts as hanging.
PATIENCE_S = 300
# What each command needs, imported before the first one is forked.
LOADED = {
    "evaluate": "softslide.experiments.evaluate",
    "export": "softslide.models.export.formats",
    "import": "softslide.pipeline.importers.run",
    "simulate": "softslide.pipeline.atlas.solve",
    "synthesize": "softslide.pipeline.synthesis.synthesize",
    "train": "softslide.experiments.train",
}


class Commands:
    """Starts `softslide` with the modules loaded. `status`: of the last one that ended; negative: the signal. root: the
    file system as the commands see it."""

    def __init__(self, server: subprocess.Popen) -> None:
        self._server = server
        self.pid = self.status = 0
        self.root = Path(f"/proc/{self._answer()}/root")

    def start(self, words: list[str], folder: Path) -> None:
        """In this folder; what is said goes to FOLDER.log, the run to FOLDER.store."""
        folder.mkdir(parents=True, exist_ok=True)
        assert self._server.stdin is not None
        request = json.dumps({"words": words, "folder": str(folder)}) + "\n"
        self._server.stdin.write(request.encode())
        self._server.stdin.flush()
        self.pid = self._answer()

    def finish(self) -> float:
        """Waits for its end; the seconds since this was asked."""
        began = time.monotonic()
        self.status = self._answer()
        return time.monotonic() - began

    def kill(self, after_s: float) -> None:
        """Kills it with SIGKILL, if it has not ended before, and waits until its workers have ended too."""
        if not self._answers(after_s):
            os.kill(self.pid, signal.SIGKILL)
        self.finish()
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            try:
                os.killpg(self.pid, 0)
            except ProcessLookupError:
                return
            time.sleep(0.02)
        raise AssertionError("workers outlive the command that was killed")

    def _answers(self, within_s: float) -> bool:
        return bool(select.select([self._server.stdout], [], [], within_s)[0])

    def _answer(self) -> int:
        assert self._answers(PATIENCE_S), "the command hangs"
        # Unbuffered: a line is there whole, as it is written at once.
        assert self._server.stdout is not None
        return int(self._server.stdout.readline())


@contextmanager
def commands(under: Sequence[str] = (), loaded: Sequence[str] = ()) -> Iterator[Commands]:
    """under: a command, with its arguments, that what starts them is started by. loaded: those that start at once from
    the first time on."""
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    pipe = subprocess.PIPE
    server = subprocess.Popen(
        [*under, sys.executable, __file__, *loaded], stdin=pipe, stdout=pipe, bufsize=0, env=environment
    )
    try:
        yield Commands(server)
    finally:
        server.kill()
        server.communicate(timeout=PATIENCE_S)


def _serve() -> None:
    import softslide

    for command in sys.argv[1:]:
        import_module(LOADED[command])
    print(os.getpid(), flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        import_module(LOADED.get(request["words"][0], "softslide"))
        pid = os.fork()
        if pid == 0:
            folder = Path(request["folder"])
            os.setsid()
            os.chdir(folder)
            os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{folder}.store/mlflow.db"
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            log = os.open(f"{folder}.log", os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
            os.dup2(log, 1)
            os.dup2(log, 2)
            status = softslide.main(request["words"])
            # As at an interpreter's end, but for the threads of libraries, which a fork has not.
            threading._shutdown()  # type: ignore[attr-defined]
            atexit._run_exitfuncs()
            os._exit(status)
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    _serve()

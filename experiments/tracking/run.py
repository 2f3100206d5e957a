"""What a command records of one run. Nothing below experiments/ imports MLflow.

Each record goes to the store at once. From the first that the store does not take, all are kept beside the result, and
the command goes on.
"""

import json
import math
import re
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mlflow.data.pandas_dataset import from_pandas

from experiments import provenance
from experiments.tracking.process import process_tags
from experiments.tracking.store import STORE_ERRORS, Record, Sender, first_line, store_address
from experiments.tracking.unsent import Unsent
from pipeline.recordings.folder import Folder

# MLflow's limit of a parameter's length; configuration.json has the whole.
LONGEST = 6000


class Run:
    """A run under way, or ended. keep: takes each of its records. place: where it is found once it has ended."""

    def __init__(self, keep: Callable[[Record], None]) -> None:
        self._keep = keep
        self.place = ""

    def metrics(self, values: Mapping[str, float]) -> None:
        """Logs numbers, linked to the model that was logged before, if any."""
        self._metrics([(name, 0, value) for name, value in values.items()])

    def losses(self, by_step: Mapping[int, float]) -> None:
        """Logs the loss at each step of a training."""
        self.by_step("loss", by_step)

    def by_step(self, name: str, values: Mapping[int, float]) -> None:
        """Logs a number at each step of something."""
        self._metrics([(name, step, value) for step, value in values.items()])

    def tags(self, values: Mapping[str, str]) -> None:
        """Logs labels that runs are searched by."""
        self._keep({"kind": "tags", "values": {_name(name): value for name, value in values.items()}})

    def parameters(self, configuration: Mapping[str, Any]) -> None:
        """Logs a configuration whole as `configuration.json` and, flattened, as parameters."""
        values = {name: str(value)[:LONGEST] for name, value in flattened(configuration).items()}
        self._keep({"kind": "parameters", "values": values})
        self.text(json.dumps(configuration, indent=1) + "\n", "configuration.json")

    def text(self, content: str, name: str) -> None:
        """Logs a text as a file of this name."""
        self._keep({"kind": "text", "content": content, "name": name})

    def files(self, folder: Path, name: str) -> None:
        """Logs a folder's files under this name."""
        self._keep({"kind": "files", "folder": str(folder.resolve()), "name": name})

    def data(self, folder: Folder, context: str) -> None:
        """Logs what a folder holds: its manifest as a dataset, named by the sensor."""
        # The folder's path is logged as a parameter: as a source, MLflow finds a local path ambiguous and warns.
        dataset = from_pandas(folder.manifest.reset_index(), name=folder.sensor.name)
        self._keep({"kind": "data", "dataset": dataset.to_dict(), "context": context})

    def model(self, bundle: Path, name: str) -> None:
        """Logs a bundle: its files, and a model that reads recordings. Metrics logged after belong to that model."""
        self.files(bundle, "bundle")
        self._keep({"kind": "model", "folder": str(bundle.resolve()), "name": name})

    def register(self, name: str, tags: Mapping[str, str]) -> None:
        """Registers the model that was logged as a new version of this name."""
        self._keep({"kind": "register", "name": name, "tags": dict(tags)})

    def _metrics(self, values: Sequence[tuple[str, int, float]]) -> None:
        rows = [(_name(name), step, value) for name, step, value in values]
        self._keep({"kind": "metrics", "values": rows, "time_ms": _now_ms()})


UNTRACKED = Run(lambda record: None)


class _Log:
    """Sends records, or keeps them from the first on that the store does not take."""

    def __init__(self, sender: Sender, beside: Path) -> None:
        self.sender, self.beside = sender, beside
        self.unsent: Unsent | None = None
        self.lost = False

    def __call__(self, record: Record) -> None:
        if self.unsent is None and not self.lost:
            try:
                return self.sender.send(record, Path("/"))
            except STORE_ERRORS as error:
                self._keep_from_here(first_line(error))
        if self.unsent is not None:
            try:
                self.unsent.keep(record)
            except OSError as error:
                self.lost = True
                self.unsent.remove()
                told = (
                    f"run not logged: it cannot be kept in {self.unsent.folder} ({error.strerror or error})"
                )
                self.unsent = None
                print(told, file=sys.stderr)

    def _keep_from_here(self, fault: str) -> None:
        told = f"run not logged: {self.sender.address} does not take it ({fault})"
        try:
            self.unsent = Unsent(self.beside, self.sender)
        except OSError as error:
            self.lost = True
            print(f"{told}, nor can it be kept in {self.beside.parent} ({error.strerror})", file=sys.stderr)
            return
        kept = self.unsent.folder
        print(f"{told}; what is missing is kept in {kept}, 'softslide sync {kept}' sends it", file=sys.stderr)


@contextmanager
def tracked(
    command: str,
    name: str,
    configuration: Mapping[str, Any],
    beside: Path,
    *,
    tags: Mapping[str, str] | None = None,
    parent: Mapping[str, str] | None = None,
    store: str | None = None,
) -> Iterator[Run]:
    """A run of this name, with its configuration, code, packages and computer. It ends as failed when the block raises.

    command: what the run is of, its tag `command`. beside: the result, beside which is kept what the store does not
    take. parent: tags of the run that this one belongs to; the last such run is taken, if there is one. store: as in
    `store_address`.
    """
    log = _Log(Sender(store_address(store)), beside)
    run = Run(log)
    machine = provenance.machine()
    marks = {"command": command, "code": provenance.code_revision(), "processor": machine["processor"]}
    marks |= process_tags()
    log(
        {
            "kind": "begin",
            "name": name,
            "tags": {**marks, **(tags or {})},
            "parent": dict(parent or {}),
            "time_ms": _now_ms(),
        }
    )
    status = "FAILED"
    try:
        run.parameters({"command": command, **configuration})
        run.text(provenance.packages(), "environment.txt")
        run.text(json.dumps(machine, indent=1) + "\n", "machine.json")
        yield run
        status = "FINISHED"
    finally:
        log({"kind": "end", "status": status, "time_ms": _now_ms()})
        run.place = f"run {log.sender.run} in {log.sender.address}"
        if log.unsent is not None or log.lost:
            run.place = "no run" if log.unsent is None else str(log.unsent.folder)


def flattened(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys joined by a dot."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat


def finite(figures: Mapping[str, float]) -> dict[str, float]:
    """Those that are numbers: not every store takes NaN or infinity."""
    return {name: float(value) for name, value in figures.items() if math.isfinite(value)}


def _name(name: str) -> str:
    """A name that MLflow takes: a split may have any, such as one with a comma."""
    return re.sub(r"[^\w\-. /]", "_", name, flags=re.ASCII)


def _now_ms() -> int:
    return int(time.time() * 1000)

"""Runs in an MLflow store. Nothing outside experiments/ imports MLflow.

The store is `sqlite:///mlflow.db` in the current folder, or what MLFLOW_TRACKING_URI names. A store that is down costs
a run's record, never its result.
"""

import json
import logging
import math
import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

# Set before the import. No usage data is sent; a server that does not answer is given up after seconds, not minutes.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "30")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
# Standard output is for results.
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")

import mlflow
from mlflow.data.pandas_dataset import from_pandas
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.exceptions import MlflowException
from mlflow.utils.mlflow_tags import MLFLOW_DATASET_CONTEXT, MLFLOW_PARENT_RUN_ID
from mlflow.utils.time import get_current_time_millis
from sqlalchemy.exc import SQLAlchemyError

from softslide.experiments import provenance
from softslide.experiments.flattened import flattened
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.staging import locked

DEFAULT_STORE = "sqlite:///mlflow.db"
LOCAL = "sqlite:///"
# The experiment that holds the runs, and the name that bundles are registered under.
EXPERIMENT = MODEL = "softslide"
# What a store raises that is down, full, locked or refuses a record.
STORE_ERRORS = (MlflowException, SQLAlchemyError, OSError)
# MLflow's limit of a parameter's length; configuration.json has the whole.
LONGEST = 6000
# Free disk that a new local store needs (MLflow 3.17: 1.0 MB, and its journal).
TABLES_BYTES = 3_000_000

T = TypeVar("T")


class Run:
    """A run under way, or ended. From the first record that the store does not take on, nothing is logged.

    address: of the store; empty: nothing is logged. identifier: the run's in the store.
    """

    def __init__(self, address: str = "") -> None:
        self.address, self.identifier = address, ""
        self._client: mlflow.MlflowClient | None = None

    @property
    def place(self) -> str:
        """Where the run is found."""
        return f"run {self.identifier} in {self.address}" if self.address else "no run"

    def log(self, record: Callable[[mlflow.MlflowClient, str], Any]) -> None:
        """Calls a function of the client and the run's identifier; says in a line if the store does not take it."""
        if not self.address:
            return
        try:
            self._client = self._client or client_of(self.address)
            record(self._client, self.identifier)
        except STORE_ERRORS as error:
            print(f"run not logged: {self.address} does not take it ({first_line(error)})", file=sys.stderr)
            self.address = ""

    def metrics(self, values: Mapping[str, float]) -> None:
        """Logs numbers; those that are not finite are left out."""
        self._metrics([(name, 0, value) for name, value in values.items()])

    def losses(self, by_step: Mapping[int, float]) -> None:
        """Logs the loss at each step of a training."""
        self._metrics([("loss", step, value) for step, value in by_step.items()])

    def tags(self, values: Mapping[str, str]) -> None:
        """Logs labels that runs are searched by."""
        rows = [RunTag(_name(name), value) for name, value in values.items()]
        self.log(lambda client, run: client.log_batch(run, tags=rows))

    def parameters(self, configuration: Mapping[str, Any]) -> None:
        """Logs a configuration whole as `configuration.json` and, flattened, as parameters."""
        rows = [Param(name, str(value)[:LONGEST]) for name, value in flattened(configuration).items()]
        self.log(lambda client, run: client.log_batch(run, params=rows))
        self.text(json.dumps(configuration, indent=1) + "\n", "configuration.json")

    def text(self, content: str, name: str) -> None:
        """Logs a text as a file of this name."""
        self.log(lambda client, run: client.log_text(run, content, name))

    def files(self, folder: Path, name: str) -> None:
        """Logs a folder's files under this name."""
        self.log(lambda client, run: client.log_artifacts(run, str(folder), name))

    def data(self, folder: Folder, context: str) -> None:
        """Logs what a folder holds: its manifest as a dataset, named by the sensor."""
        # The folder's path is logged as a parameter: as a source, MLflow finds a local path ambiguous and warns.
        dataset = from_pandas(folder.manifest.reset_index(), name=folder.sensor.name).to_dict()
        given = DatasetInput(Dataset(**dataset), [InputTag(MLFLOW_DATASET_CONTEXT, context)])
        self.log(lambda client, run: client.log_inputs(run, [given]))

    def register(self, tags: Mapping[str, str]) -> None:
        """Registers the bundle that was logged as a new version of MODEL."""

        def record(client: mlflow.MlflowClient, run: str) -> None:
            try:
                client.create_registered_model(MODEL)
            except MlflowException as error:
                if error.error_code != "RESOURCE_ALREADY_EXISTS":
                    raise
            client.create_model_version(
                MODEL, f"runs:/{run}/bundle", run, tags=dict(tags), await_creation_for=0
            )

        self.log(record)

    def _metrics(self, values: Sequence[tuple[str, int, float]]) -> None:
        now = get_current_time_millis()
        rows = [Metric(_name(name), value, now, step) for name, step, value in values if math.isfinite(value)]
        self.log(lambda client, run: client.log_batch(run, metrics=rows))


@contextmanager
def tracked(
    command: str,
    name: str,
    configuration: Mapping[str, Any],
    *,
    tags: Mapping[str, str] | None = None,
    parent: Mapping[str, str] | None = None,
    store: str | None = None,
) -> Iterator[Run]:
    """A run of this name, with its configuration, code, packages and computer. It ends as failed when the block raises.

    command: what the run is of, its tag `command`. parent: tags of the run that this one belongs to; the last such run
    is taken, if there is one. store: as in `store_address`.
    """
    run, machine = Run(store_address(store)), provenance.machine()
    marks = {"command": command, "code": provenance.code_revision(), "processor": machine["processor"]}

    def begin(client: mlflow.MlflowClient, _: str) -> None:
        if above := find_run(client, parent) if parent else None:
            marks[MLFLOW_PARENT_RUN_ID] = above.info.run_id
        experiment = open_experiment(client, run.address)
        begun = client.create_run(experiment, tags={**marks, **(tags or {})}, run_name=name)
        run.identifier = begun.info.run_id

    run.log(begin)
    status = "FAILED"
    try:
        run.parameters({"command": command, **configuration})
        run.text(provenance.packages(), "environment.txt")
        run.text(json.dumps(machine, indent=1) + "\n", "machine.json")
        yield run
        status = "FINISHED"
    finally:
        run.log(lambda client, identifier: client.set_terminated(identifier, status))


def store_address(named: str | None = None) -> str:
    """The tracking URI: the one named, MLFLOW_TRACKING_URI, or DEFAULT_STORE."""
    return named or os.environ.get("MLFLOW_TRACKING_URI") or DEFAULT_STORE


def client_of(address: str) -> mlflow.MlflowClient:
    """A client of the store, for runs and registered models alike."""
    # A new store logs each of its migrations, a lost connection each attempt.
    for chatty in ("alembic", "mlflow.store.db.utils", "mlflow.tracking.fluent", "urllib3.connectionpool"):
        logging.getLogger(chatty).setLevel(logging.ERROR)
    place = _local(address)
    if place is None:
        return mlflow.MlflowClient(address, address)
    folder = place.resolve().parent
    folder.mkdir(parents=True, exist_ok=True)
    # One process at a time makes a local store.
    with locked(folder):
        if not place.exists():
            _make_local(place)
        return mlflow.MlflowClient(address, address)


def open_experiment(client: mlflow.MlflowClient, address: str) -> str:
    """The experiment's identifier. Files of a local store lie next to it, not in the current folder."""
    files = _local(address)
    place = None if files is None else files.resolve().with_name("mlartifacts").as_uri()
    try:
        found = client.get_experiment_by_name(EXPERIMENT)
        return found.experiment_id if found else client.create_experiment(EXPERIMENT, place)
    except MlflowException as error:
        # Another process has been quicker.
        if error.error_code == "RESOURCE_ALREADY_EXISTS" and (
            found := client.get_experiment_by_name(EXPERIMENT)
        ):
            return found.experiment_id
        raise


def find_run(
    client: mlflow.MlflowClient, tags: Mapping[str, str], status: str = ""
) -> mlflow.entities.Run | None:
    """The last run with all these tags, and this status if one is given; None if there is none."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    if experiment is None:
        return None
    wanted = [f"tags.`{name}` = '{value}'" for name, value in tags.items()]
    wanted += [f"attributes.status = '{status}'"] if status else []
    runs = client.search_runs([experiment.experiment_id], " and ".join(wanted), max_results=1)
    return runs[0] if runs else None


def last_duration_s(tags: Mapping[str, str], named: str | None = None) -> float | None:
    """How long the last such run took that finished on a computer like this one, in s; None if none is known."""
    here = {**tags, "processor": provenance.machine()["processor"]}
    try:
        run = find_run(client_of(store_address(named)), here, "FINISHED")
    except STORE_ERRORS:
        return None
    return None if run is None else (run.info.end_time - run.info.start_time) / 1000


def logged_run(identifier: str, folder: Path, named: str | None = None) -> dict[str, str]:
    """The tags of a run of the store; its files are fetched into a new folder.

    Raises:
        InputError: no such run, or the store does not answer.
    """

    def fetch(client: mlflow.MlflowClient) -> dict[str, str]:
        tags = dict(client.get_run(identifier).data.tags)
        folder.mkdir(parents=True)
        client.download_artifacts(identifier, "", str(folder))
        return tags

    return _asked(fetch, f"run {identifier}", named)


def fetched(address: str, into: Path, named: str | None = None) -> Path:
    """The bundle that `models:/NAME@ALIAS` or `models:/NAME/VERSION` names, fetched into a folder below `into`.

    Raises:
        InputError: the store does not answer, it has no such model, or that is not a bundle.
    """

    def fetch(client: mlflow.MlflowClient) -> Path:
        name, at, alias = address.removeprefix("models:/").partition("@")
        name, _, version = name.partition("/")
        if at:
            version = client.get_model_version_by_alias(name, alias).version
        source = client.get_model_version_download_uri(name, version)
        into.mkdir(parents=True, exist_ok=True)
        return Path(
            mlflow.artifacts.download_artifacts(source, dst_path=str(into), tracking_uri=client.tracking_uri)
        )

    card = next(_asked(fetch, address, named).rglob("model.json"), None)
    if card is None:
        raise InputError(f"{address}: not a bundle that 'train' registered; name another")
    # Reports name a bundle by its folder.
    return card.parent.rename(into / re.sub(r"\W+", "-", address.removeprefix("models:/")))


def first_line(error: BaseException) -> str:
    """What an error says, in a line of at most 160 characters."""
    return " ".join(str(error).split())[:160]


def _asked(fetch: Callable[[mlflow.MlflowClient], T], what: str, named: str | None) -> T:
    address = store_address(named)
    try:
        return fetch(client_of(address))
    except STORE_ERRORS as error:
        raise InputError(
            f"{what}: not found in {address} ({first_line(error)}); name another, or the store in MLFLOW_TRACKING_URI"
        ) from None


def _local(address: str) -> Path | None:
    """The file of a local store; None for a server's."""
    return Path(address.removeprefix(LOCAL)) if address.startswith(LOCAL) and "?" not in address else None


def _make_local(place: Path) -> None:
    """Makes a local store whole or not at all: killed between two tables it would take no run."""
    # MLflow tries again where a full disk ended the first try, and fails on what that left.
    if shutil.disk_usage(place.resolve().parent).free < TABLES_BYTES:
        raise OSError(f"no space left on device: '{place}'")
    scratch = place.with_name(f".{place.name}.unfinished")
    scratch.unlink(missing_ok=True)
    scratch.with_name(f"{scratch.name}-journal").unlink(missing_ok=True)
    mlflow.MlflowClient(f"{LOCAL}{scratch}", f"{LOCAL}{scratch}")
    scratch.replace(place)


def _name(name: str) -> str:
    """A name that MLflow takes: a split may have any, such as one with a comma."""
    return re.sub(r"[^\w\-. /]", "_", name, flags=re.ASCII)

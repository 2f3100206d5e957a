"""An MLflow store: where it is, and how the records of a run are sent to it.

The store is `sqlite:///mlflow.db` in the current folder, or what MLFLOW_TRACKING_URI names.
"""

import errno
import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Set before the import. No usage data is sent; a server that does not answer is given up after seconds, not minutes.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")
os.environ.setdefault("MLFLOW_HTTP_REQUEST_TIMEOUT", "30")
os.environ.setdefault("MLFLOW_ENABLE_ARTIFACTS_PROGRESS_BAR", "false")
# Standard output is for results.
os.environ.setdefault("MLFLOW_SUPPRESS_PRINTING_URL_TO_STDOUT", "true")

import mlflow
from mlflow.entities import Dataset, DatasetInput, InputTag, Metric, Param, RunTag
from mlflow.exceptions import MlflowException
from mlflow.utils.mlflow_tags import MLFLOW_DATASET_CONTEXT, MLFLOW_PARENT_RUN_ID
from sqlalchemy.exc import SQLAlchemyError

from experiments.provenance import machine
from experiments.tracking.process import HOST, is_gone, process_tags
from experiments.tracking.recording_model import log_recording_model
from features.errors import InputError
from pipeline.staging import locked

DEFAULT_STORE = "sqlite:///mlflow.db"
EXPERIMENT = "softslide"
LOCAL = "sqlite:///"
# What a store raises that is gone, full, locked or refuses a record.
STORE_ERRORS = (MlflowException, SQLAlchemyError, OSError)
# What MLflow's tables take while they are made, with room to spare (3.17: 1.0 MB, and their journal).
TABLES_BYTES = 3_000_000
# Parameters and metrics that one request may carry (MLflow's REST API: 100 and 1000).
BATCH = 100

Record = Mapping[str, Any]


def store_address(named: str | None = None) -> str:
    """The tracking URI: the one named, MLFLOW_TRACKING_URI, or DEFAULT_STORE."""
    return named or os.environ.get("MLFLOW_TRACKING_URI") or DEFAULT_STORE


def client_of(address: str) -> mlflow.MlflowClient:
    """A client of the store, for runs and registered models alike."""
    # A new store logs each of its migrations, a lost connection each attempt.
    for chatty in ("alembic", "mlflow.store.db.utils", "mlflow.tracking.fluent", "urllib3.connectionpool"):
        logging.getLogger(chatty).setLevel(logging.ERROR)
    named = os.environ.get("MLFLOW_TRACKING_URI")
    mlflow.set_tracking_uri(address)
    mlflow.set_registry_uri(address)
    # MLflow puts the address into the environment, where it would look like the user's choice.
    if named is None:
        os.environ.pop("MLFLOW_TRACKING_URI", None)
    else:
        os.environ["MLFLOW_TRACKING_URI"] = named
    with _alone(address):
        _make_whole(address)
        return mlflow.MlflowClient(address, address)


@dataclass(frozen=True)
class LoggedRun:
    """A run as the store holds it: its tags, and a folder with its files."""

    identifier: str
    tags: dict[str, str]
    files: Path


def logged_run(identifier: str, folder: Path, named: str | None = None) -> LoggedRun:
    """A run of the store, its files fetched into a new folder.

    Raises:
        InputError: no such run, or the store does not answer.
    """
    address = store_address(named)
    try:
        client = client_of(address)
        run = client.get_run(identifier)
        folder.mkdir(parents=True)
        client.download_artifacts(identifier, "", str(folder))
    except STORE_ERRORS as error:
        raise InputError(
            f"run {identifier}: not to be had from {address} ({first_line(error)}); name a run of this store, "
            "or the store in MLFLOW_TRACKING_URI"
        ) from None
    return LoggedRun(identifier, dict(run.data.tags), folder)


class Sender:
    """Sends records to one run of a store, in their order.

    run: its identifier in the store, empty before it began. model: the logged model that metrics belong to, if any.
    """

    def __init__(self, address: str, run: str = "", model: str = "") -> None:
        self.address, self.run, self.model = address, run, model
        self._client: mlflow.MlflowClient | None = None

    def send(self, record: Record, files: Path) -> None:
        """Sends one record; files: the folder that its relative paths start from.

        Raises:
            STORE_ERRORS: the store does not take it.
        """
        if self._client is None:
            self._client = client_of(self.address)
        getattr(self, f"_{record['kind']}")(self._client, record, files)

    def _begin(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        experiment = open_experiment(client, self.address)
        end_killed(client, experiment)
        tags = dict(record["tags"])
        if parent := find_run(client, record["parent"]) if record["parent"] else None:
            tags[MLFLOW_PARENT_RUN_ID] = parent.info.run_id
            models = parent.outputs.model_outputs if parent.outputs else []
            self.model = models[0].model_id if models else ""
        self.run = client.create_run(experiment, record["time_ms"], tags, record["name"]).info.run_id

    def _end(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        client.set_terminated(self.run, record["status"], record["time_ms"])

    def _parameters(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        rows = [Param(name, value) for name, value in record["values"].items()]
        for first in range(0, len(rows), BATCH):
            client.log_batch(self.run, params=rows[first : first + BATCH])

    def _tags(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        client.log_batch(self.run, tags=[RunTag(name, value) for name, value in record["values"].items()])

    def _metrics(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        rows = [
            Metric(name, value, record["time_ms"], step, model_id=self.model or None, run_id=self.run)
            for name, step, value in record["values"]
        ]
        for first in range(0, len(rows), BATCH):
            client.log_batch(self.run, metrics=rows[first : first + BATCH])

    def _text(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        client.log_text(self.run, record["content"], record["name"])

    def _files(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        client.log_artifacts(self.run, str(files / record["folder"]), record["name"])

    def _data(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        context = InputTag(MLFLOW_DATASET_CONTEXT, record["context"])
        client.log_inputs(self.run, [DatasetInput(Dataset(**record["dataset"]), [context])])

    def _model(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        self.model = log_recording_model(client, files / record["folder"], record["name"], self.run)

    def _register(self, client: mlflow.MlflowClient, record: Record, files: Path) -> None:
        try:
            client.create_registered_model(record["name"])
        except MlflowException as error:
            if error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
        source = client.get_logged_model(self.model).artifact_location
        version = client.create_model_version(
            record["name"],
            source,
            self.run,
            tags=dict(record["tags"]),
            await_creation_for=0,
            model_id=self.model,
        )
        client.set_tag(self.run, "registered", f"{record['name']} {version.version}")


def open_experiment(client: mlflow.MlflowClient, address: str) -> str:
    """The experiment's identifier. Files of a local store lie beside it; MLflow's own default is the current folder."""
    with _alone(address):
        if found := client.get_experiment_by_name(EXPERIMENT):
            return found.experiment_id
        beside = None
        if address.startswith(LOCAL):
            beside = Path(address.removeprefix(LOCAL)).resolve().with_name("mlartifacts").as_uri()
        try:
            return client.create_experiment(EXPERIMENT, beside)
        except MlflowException as error:
            # Another process has been quicker.
            if error.error_code == "RESOURCE_ALREADY_EXISTS" and (
                found := client.get_experiment_by_name(EXPERIMENT)
            ):
                return found.experiment_id
            raise


def end_killed(client: mlflow.MlflowClient, experiment: str) -> None:
    """Marks as killed the runs under way whose process was one of this computer and is gone; they end when it is seen.

    Each run that begins does so. Runs of other computers are theirs to look after.
    """
    wanted = f"attributes.status = 'RUNNING' and tags.{HOST} = '{process_tags()[HOST]}'"
    for run in client.search_runs([experiment], wanted):
        if is_gone(run.data.tags):
            client.set_terminated(run.info.run_id, "KILLED")


def find_run(
    client: mlflow.MlflowClient, tags: Mapping[str, str], status: str = ""
) -> mlflow.entities.Run | None:
    """The last run with all these tags, and this status if one is given; None if there is none."""
    experiment = client.get_experiment_by_name(EXPERIMENT)
    if experiment is None:
        return None
    wanted = " and ".join(f"tags.`{name}` = '{value}'" for name, value in tags.items())
    if status:
        wanted += f" and attributes.status = '{status}'"
    runs = client.search_runs([experiment.experiment_id], wanted, max_results=1)
    return runs[0] if runs else None


def last_duration_s(tags: Mapping[str, str], named: str | None = None) -> float | None:
    """How long the last such run took that finished on a computer like this one; None: there is none to be had."""
    try:
        here = {**tags, "processor": machine()["processor"]}
        run = find_run(client_of(store_address(named)), here, "FINISHED")
    except STORE_ERRORS:
        return None
    return None if run is None else (run.info.end_time - run.info.start_time) / 1000


def first_line(error: BaseException) -> str:
    """What an error says, in a line of at most 160 characters."""
    return " ".join(str(error).split())[:160]


def _make_whole(address: str) -> None:
    """Makes a local store that is not there yet, its tables first: a process killed between them left one for good that
    takes no run."""
    place = Path(address.removeprefix(LOCAL))
    if not address.startswith(LOCAL) or "?" in address or place.exists():
        return
    scratch = place.with_name(f".{place.name}.unfinished")
    parts = (scratch, scratch.with_name(f"{scratch.name}-journal"))
    for left in parts:
        left.unlink(missing_ok=True)
    # MLflow tries again on what a full disk has left of the first try, and tells of that.
    if shutil.disk_usage(place.resolve().parent).free < TABLES_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(place))
    try:
        mlflow.MlflowClient(f"{LOCAL}{scratch}", f"{LOCAL}{scratch}")
        scratch.replace(place)
    finally:
        for left in parts:
            left.unlink(missing_ok=True)


@contextmanager
def _alone(address: str) -> Iterator[None]:
    """One process at a time makes a local store: its tables, made by two at once, are made twice and fail."""
    if not address.startswith(LOCAL):
        yield
        return
    folder = Path(address.removeprefix(LOCAL)).resolve().parent
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        yield

"""Each training as an MLflow run. Nothing below experiments/ imports MLflow.

The store is `sqlite:///mlflow.db` in the current folder, or what MLFLOW_TRACKING_URI names.
"""

import hashlib
import json
import logging
import os
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import onnx

from pipeline.recordings.folder import Folder

# Set before the import: no usage data is sent.
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

import mlflow
import mlflow.onnx
from mlflow.data.pandas_dataset import from_pandas
from mlflow.entities import Metric
from mlflow.models import ModelSignature
from mlflow.types import ColSpec, Schema, TensorSpec

DEFAULT_STORE = "sqlite:///mlflow.db"
EXPERIMENT = "softslide"
# Requirements of the served bundle. Listed, since MLflow takes 4 to 12 s a model to infer them.
SERVING = ("numpy", "onnxruntime", "onnx")


@dataclass(frozen=True)
class Run:
    """A run under way, or ended: where it is kept and what it is called there."""

    store: str
    identifier: str

    def metrics(self, values: Mapping[str, float], model: str | None = None) -> None:
        """Logs numbers, linked to a model logged before if its identifier is given."""
        mlflow.log_metrics(dict(values), run_id=self.identifier, model_id=model)

    def losses(self, by_step: Mapping[int, float]) -> None:
        """Logs the loss at each step of a training."""
        now = int(time.time() * 1000)
        course = [Metric("loss", loss, now, step) for step, loss in by_step.items()]
        mlflow.MlflowClient().log_batch(self.identifier, course)

    def text(self, content: str, name: str) -> None:
        """Logs a text as a file of this name."""
        mlflow.log_text(content, name, run_id=self.identifier)

    def files(self, folder: Path, name: str) -> None:
        """Logs a folder's files under this name."""
        mlflow.log_artifacts(str(folder), name, run_id=self.identifier)

    def data(self, folder: Folder, context: str) -> None:
        """Logs what a folder holds: its manifest as a dataset, named by the sensor."""
        # The folder's path is logged as a parameter: as a source, MLflow finds a local path ambiguous and warns.
        mlflow.log_input(from_pandas(folder.manifest.reset_index(), name=folder.sensor.name), context=context)

    def model(self, bundle: Path, name: str) -> str:
        """Logs a bundle's graph with the signature of its tensors; its identifier in the store."""
        graph = onnx.load(bundle / "model.onnx")
        logged = mlflow.onnx.log_model(
            graph,
            name=name,
            signature=signature(graph),
            pip_requirements=[f"{package}=={version(package)}" for package in SERVING],
            onnx_execution_providers=["CPUExecutionProvider"],
            save_as_external_data=False,
        )
        self.files(bundle, "bundle")
        return logged.model_id


@contextmanager
def tracked(
    name: str, configuration: Mapping[str, Any], tags: Mapping[str, str], store: str | None = None
) -> Iterator[Run]:
    """A run of this name. It ends as failed when the block raises.

    configuration: logged whole as `configuration.json` and, flattened, as parameters. store: an MLflow tracking
    URI; where none is given, MLFLOW_TRACKING_URI or DEFAULT_STORE.
    """
    store = store or os.environ.get("MLFLOW_TRACKING_URI") or DEFAULT_STORE
    # A new store logs each of its migrations.
    for chatty in ("alembic", "mlflow.store.db.utils", "mlflow.tracking.fluent"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    mlflow.set_tracking_uri(store)
    _open_experiment(store)
    with mlflow.start_run(run_name=name, tags=dict(tags)) as active:
        run = Run(store, active.info.run_id)
        mlflow.log_params(flattened(configuration))
        run.text(json.dumps(configuration, indent=1) + "\n", "configuration.json")
        yield run


def _open_experiment(store: str) -> None:
    """Files of a local store lie beside it; MLflow's own default is the current folder."""
    local = "sqlite:///"
    if store.startswith(local) and mlflow.get_experiment_by_name(EXPERIMENT) is None:
        beside = Path(store.removeprefix(local)).resolve().with_name("mlartifacts")
        mlflow.create_experiment(EXPERIMENT, artifact_location=beside.as_uri())
    mlflow.set_experiment(EXPERIMENT)


def signature(graph: onnx.ModelProto) -> ModelSignature:
    """The graph's tensors by name, type and shape; the free dimension is the batch."""

    def schema(values: Any) -> Schema:
        specs: list[ColSpec | TensorSpec] = []
        for value in values:
            tensor = value.type.tensor_type
            kind = onnx.helper.tensor_dtype_to_np_dtype(tensor.elem_type)
            shape = tuple(d.dim_value if d.HasField("dim_value") else -1 for d in tensor.shape.dim)
            specs.append(TensorSpec(kind, shape, value.name))
        return Schema(specs)

    return ModelSignature(inputs=schema(graph.graph.input), outputs=schema(graph.graph.output))


def data_hashes(folder: Folder) -> dict[str, str]:
    """SHA-256 of what a folder's recordings hold: sensor, labels as used, and all slides in their order."""
    slides = hashlib.sha256()
    for file in folder.manifest["file"]:
        slides.update(hashlib.sha256((folder.root / file).read_bytes()).digest())
    return {
        "sensor": hashlib.sha256((folder.root / "sensor.toml").read_bytes()).hexdigest(),
        "manifest": hashlib.sha256(folder.manifest.to_csv().encode()).hexdigest(),
        "slides": slides.hexdigest(),
    }


def code_revision() -> str:
    """The commit that runs, with `+changes` where files differ from it; `unknown` outside a clone."""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        return git("rev-parse", "HEAD") + ("+changes" if git("status", "--porcelain", "-uno") else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def flattened(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested keys joined by a dot."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            flat |= flattened(value, f"{prefix}{key}.")
        else:
            flat[prefix + key] = value
    return flat

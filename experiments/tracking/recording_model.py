"""A bundle as an MLflow model that reads a recording: a table of time_s (s) and volts in, estimate records out.

The model holds the bundle's files, the runtime's source (features/ and serve/) and `served_recording.py`; nothing is
pickled, and it needs the base install beside MLflow.
"""

import shutil
import warnings
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import mlflow
from mlflow.models import Model, ModelSignature
from mlflow.types import ColSpec, DataType, ParamSchema, ParamSpec, Schema, TensorSpec

from features.card import read_card

HERE = Path(__file__).parent
ROOMS = ("features", "serve")
# Requirements of the base install. Listed, since MLflow takes 4 to 12 s a model to infer them.
BASE = ("numpy", "onnxruntime")
# Where the bundle lies in the model's files.
BUNDLE = "artifacts/bundle"


def log_recording_model(client: mlflow.MlflowClient, bundle: Path, name: str, run: str) -> str:
    """Logs the bundle as a model of a run; the model's identifier in the store."""
    # Made here: MLflow would make it in the default experiment, with its files in the current folder.
    experiment = client.get_run(run).info.experiment_id
    model = client.create_logged_model(experiment, name, source_run_id=run)
    with warnings.catch_warnings(), TemporaryDirectory() as scratch:
        # MLflow calls what it copies by the folder's name.
        copy = shutil.copytree(bundle, Path(scratch) / "bundle")
        # An example would be served once more at each training; the signature says what is read.
        warnings.filterwarnings("ignore", ".*input example was not provided", UserWarning)
        Model.log(
            artifact_path=None,
            flavor=mlflow.pyfunc,
            name=name,
            model_id=model.model_id,
            run_id=run,
            python_model=str(HERE / "served_recording.py"),
            artifacts={"bundle": str(copy)},
            code_paths=[str(HERE.parents[1] / room) for room in ROOMS],
            signature=signature(read_card(bundle / "model.json").columns),
            pip_requirements=[f"{package}=={version(package)}" for package in BASE],
        )
    return model.model_id


def signature(channels: Sequence[str]) -> ModelSignature:
    """A column of numbers for the time and each channel; `track` asks for every estimate, not the last alone."""
    columns: list[ColSpec | TensorSpec] = [ColSpec(DataType.double, name) for name in ("time_s", *channels)]
    return ModelSignature(
        inputs=Schema(columns), params=ParamSchema([ParamSpec("track", DataType.boolean, False)])
    )

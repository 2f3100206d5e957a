"""The code of a logged model, run where the model is served: the estimates of a recording, as `softslide predict`."""

from typing import Any

import mlflow
import numpy as np
import pandas as pd
from mlflow.pyfunc import PythonModel, PythonModelContext

from features.errors import InputError
from serve.files import checked_volts
from serve.localizer import Localizer
from serve.records import record


class RecordingModel(PythonModel):
    """A table of `time_s` in s and each channel in V, one recording, to records of its estimates."""

    def load_context(self, context: PythonModelContext) -> None:
        """Opens the bundle.

        Raises:
            InputError: it is missing, damaged, or of another format.
        """
        from pathlib import Path

        self._localizer = Localizer.load(Path(context.artifacts["bundle"]))

    def predict(self, context: Any, model_input: pd.DataFrame, params: dict | None = None) -> list[dict]:
        """The estimate at the recording's end, in a list; with the parameter `track` every estimate, one a block.

        Raises:
            InputError: too few samples, a cell that is no finite number, a gap in time, or another sample rate.
        """
        card = self._localizer.card
        columns = ("time_s", *card.columns)
        if absent := [name for name in columns if name not in model_input]:
            raise InputError(f"recording: column '{absent[0]}' is missing; add or rename it")
        values = model_input[list(columns)].to_numpy(dtype=float)
        volts = checked_volts("recording", columns, np.ascontiguousarray(values), card.sample_rate_hz)
        self._localizer.reset()
        if (params or {}).get("track"):
            return [record(estimate) for estimate in self._localizer.push(volts)]
        self._localizer.feed(volts)
        return [record(self._localizer.read())]


mlflow.models.set_model(RecordingModel())

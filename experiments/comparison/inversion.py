"""The inverted response map, read out at the same moments and through the same runtime as a bundle, without a graph.

So what separates a slide from a touch, and a dead accelerometer from a live one, is the device's own.
"""

from collections.abc import Callable
from dataclasses import asdict
from typing import cast

import numpy as np
import onnxruntime as ort
import pandas as pd

from softslide.experiments.evaluation.readout import COLUMNS, rows_of
from softslide.experiments.train import design_of
from softslide.features.card import HALF_WIDTH_SD, Card, Interval, Validity
from softslide.features.stream.conditioning import Conditioning
from softslide.models.cnn.fit import CnnConfig
from softslide.models.cnn.inversion import Inversion
from softslide.models.response_map.select import calibrated_map
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.folder import Folder
from softslide.serve.localizer import Localizer

# Windows volts (n, 3 A, 64) V and elapsed_s (n,) s -> rows (n, K) of a card's outputs.
Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]
VALIDITY = Validity(misfit=20.0, direction_sd_deg=6.0, log_speed_sd=0.1)
# Its own standard deviations, for 90 % of a normal distribution.
INTERVALS = {name: Interval(HALF_WIDTH_SD, 0.0) for name in ("direction_deg", "log_speed", "offset_mm")}


def invert(calibration: Folder, test: Folder) -> tuple[pd.DataFrame, Predict, Conditioning]:
    """Calibrates the map on some slides and inverts it on others: their rows of `predictions.csv`, the estimator and
    the signal path that it reads.

    Raises:
        InputError: the map cannot be calibrated on these.
    """
    config, conditioning = CnnConfig(), conditioning_for(calibration, Conditioning())
    made = calibrated_map(
        calibration, design_of(calibration, None), conditioning, config.calibration, config.spread
    )
    inversion = Inversion(made.response, made.conditioning.block_s)
    card = window_card(inversion.outputs, test, made.conditioning, VALIDITY, INTERVALS)
    return window_predictions(inversion.predict, card, test), inversion.predict, conditioning


def window_card(
    outputs: tuple[str, ...],
    folder: Folder,
    conditioning: Conditioning,
    validity: Validity,
    intervals: dict[str, Interval],
) -> Card:
    """The card of an estimator on windows that has no graph and ships nowhere."""
    sensor = folder.sensor
    return Card(
        model="inversion",
        input="window",
        outputs=outputs,
        sensor=asdict(sensor),
        channels=sensor.channels,
        sample_rate_hz=sensor.sample_rate_hz,
        reference_mm=sensor.reference_mm,
        conditioning=conditioning,
        intervals=intervals,
        validity=validity,
        provenance={},
        golden={},
        graph_sha256="",
    )


def window_predictions(predict: Predict, card: Card, folder: Folder) -> pd.DataFrame:
    """The rows of `predictions.csv` for every recording of the folder, in the manifest's order."""
    localizer, rows = Localizer(card, cast(ort.InferenceSession, _Session(predict))), []
    for name in folder.manifest.index:
        recording = folder.load(name)
        rows += rows_of(localizer, recording, recording.volts, folder.manifest.loc[name].to_dict())
    return pd.DataFrame(rows, columns=list(COLUMNS))


class _Session:
    """The estimator in place of the runtime's ONNX session."""

    def __init__(self, predict: Predict) -> None:
        self._predict = predict

    def run(self, names: list[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Rows (1, K) of one window."""
        return [self._predict(inputs["volts"], inputs["elapsed_s"]).astype(np.float32)]

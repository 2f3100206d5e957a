"""The inverted response map, read out at the same moments and through the same runtime as a bundle, without a graph.

The runtime runs twice over the recordings: first to note every window that it asks about, then with the estimator's
answers for them. So what separates a slide from a touch, and a dead accelerometer from a live one, is the device's own.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, cast

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
    noted = _Noted(len(card.outputs))
    for _ in _rows(card, noted, folder):
        pass
    if noted.windows:
        volts, elapsed_s = (np.array(values) for values in zip(*noted.windows.values(), strict=True))
        noted.rows = dict(zip(noted.windows, predict(volts, elapsed_s).astype(np.float32), strict=True))
    return pd.DataFrame(_rows(card, noted, folder), columns=list(COLUMNS))


class _Noted:
    """In place of the runtime's ONNX session: records each window and returns its row if it is known."""

    def __init__(self, outputs: int) -> None:
        self.windows: dict[bytes, tuple[np.ndarray, float]] = {}
        self.rows: dict[bytes, np.ndarray] = {}
        self._unknown = np.full(outputs, np.nan, np.float32)

    def run(self, names: list[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        """One window's row (1, K), NaN where it is not known yet."""
        volts, elapsed_s = inputs["volts"][0], float(inputs["elapsed_s"][0])
        key = volts.tobytes() + np.float64(elapsed_s).tobytes()
        self.windows.setdefault(key, (volts.copy(), elapsed_s))
        return [self.rows.get(key, self._unknown)[None]]


def _rows(card: Card, session: _Noted, folder: Folder) -> Iterator[dict[str, Any]]:
    localizer = Localizer(card, cast(ort.InferenceSession, session))
    for name in folder.manifest.index:
        recording = folder.load(name)
        yield from rows_of(localizer, recording, recording.volts, folder.manifest.loc[name].to_dict())

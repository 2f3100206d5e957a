"""Reads out an estimator that has no graph at the same moments, and through the same runtime, as a bundle.

The runtime runs twice over the recordings: first to note every window that it asks about, then with the estimator's
answers for them. So what tells a slide from a touch, and a dead accelerometer from a live one, is the device's own.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, cast

import numpy as np
import onnxruntime as ort
import pandas as pd

from experiments.evaluation.readout import COLUMNS, moments, read_at
from features.card import Card, Interval, Validity
from features.stream.conditioning import Conditioning
from pipeline.recordings.folder import Folder
from pipeline.sensor import Sensor
from serve.localizer import Localizer

# Windows volts (n, 3 A, 64) V and elapsed_s (n,) s -> rows (n, K) of a card's outputs.
Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]


def window_card(
    name: str,
    outputs: tuple[str, ...],
    sensor: Sensor,
    conditioning: Conditioning,
    validity: Validity,
    intervals: dict[str, Interval] | None = None,
) -> Card:
    """The card of an estimator on windows that has no graph and ships nowhere."""
    return Card(
        model=name,
        input="window",
        outputs=outputs,
        sensor=asdict(sensor),
        channels=sensor.channels,
        sample_rate_hz=sensor.sample_rate_hz,
        reference_mm=sensor.reference_mm,
        conditioning=conditioning,
        intervals=intervals or {},
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
        if key not in self.windows:
            self.windows[key] = volts.copy(), elapsed_s
        return [self.rows.get(key, self._unknown)[None]]


def _rows(card: Card, session: _Noted, folder: Folder) -> Iterator[dict[str, Any]]:
    localizer = Localizer(card, cast(ort.InferenceSession, session))
    for name in folder.manifest.index:
        recording = folder.load(name)
        label = folder.manifest.loc[name].to_dict()
        fractions, moments_s = zip(*moments(label, recording.time_s), strict=True)
        estimates = read_at(localizer, recording.volts, recording.time_s, moments_s)
        for fraction, estimate in zip(fractions, estimates, strict=True):
            told = {column: getattr(estimate, column) for column in COLUMNS[2:]}
            yield {"recording": name, "stroke_fraction": fraction, **told}

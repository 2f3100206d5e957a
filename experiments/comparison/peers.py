"""Every baseline fitted to one folder's calibration slides and read out on its test slides; results are cached."""

import json
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.comparison import minirocket
from experiments.derived_labels import derived
from experiments.evaluation.archive import Archive
from experiments.evaluation.readout import predictions
from experiments.evaluation.window_readout import window_card, window_predictions
from experiments.own_environment import AEON
from experiments.provenance import bundle_hash, data_hashes
from experiments.train import design_of, train
from features.card import HALF_WIDTH_SD, Interval, Validity, read_card
from features.errors import InputError
from features.stream.conditioning import Conditioning
from features.window import Window
from models.classical import regression
from models.cnn.fit import CnnConfig
from models.cnn.inversion import STARTS, Inversion
from models.held_out import offset_reach_mm
from models.registry import model_named
from models.response_map.select import CalibratedMap, calibrated_map
from pipeline.recordings.at_rest import conditioning_for
from pipeline.recordings.base_motion import without_base_motion
from pipeline.recordings.derived_labels import with_derived_labels
from pipeline.recordings.folder import Folder, read_folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows
from pipeline.staging import staged
from serve.bench.runtime import one_node
from serve.localizer import Localizer

MODELS = ("interpolation", "trees", "mlp", "gp", "minirocket", "inversion", "cnn")
# The inversion's intervals are its own standard deviations, for 90 % of a normal distribution.
INVERSION_VALIDITY = Validity(misfit=20.0, direction_sd_deg=6.0, log_speed_sd=0.1)
NORMAL = {name: Interval(HALF_WIDTH_SD, 0.0) for name in ("direction_deg", "log_speed", "offset_mm")}
# Windows timed: of models that take about a millisecond, and of the inversion.
TIMED, TIMED_SLOW = 200, 20


@dataclass(frozen=True)
class Study:
    """One folder's comparison: its recordings, and the folder of cached results.

    store: an MLflow tracking URI. jobs: recordings that a bundle reads at a time.
    """

    recordings: Path
    place: Path
    store: str
    jobs: int = 1

    @cached_property
    def taught(self) -> Folder:
        """The recordings that every model is fitted to."""
        return self._labelled(with_derived_labels, "calibration", "train")

    @cached_property
    def scored(self) -> Folder:
        """The recordings that every model is scored on."""
        return self._labelled(derived, "test")

    @cached_property
    def windows(self) -> LabelledWindows:
        """The scored slides' windows at each stroke fraction, as the runtime makes them."""
        return labelled_windows(self.scored, self.conditioning)

    @cached_property
    def conditioning(self) -> Conditioning:
        """The signal path's constants for this sensor, without a lag."""
        return conditioning_for(self.taught, Conditioning())

    @cached_property
    def calibrated(self) -> CalibratedMap:
        """The default model's calibration without its network."""
        c = CnnConfig()
        atlas = design_of(self.taught, None)
        return calibrated_map(self.taught, atlas, self.conditioning, c.calibration, c.spread)

    @cached_property
    def hashes(self) -> dict[str, Any]:
        """Hash of the recordings that are learnt from and scored."""
        return {"taught": data_hashes(self.taught), "scored": data_hashes(self.scored)}

    @cached_property
    def _folder(self) -> Folder:
        return without_base_motion(read_folder(self.recordings))

    def _labelled(self, derive: Callable[[Folder], Folder], *splits: str) -> Folder:
        folder = derive(self._folder.select(*splits)).labelled()
        if not len(folder):
            raise InputError(
                f"{self.recordings / 'manifest.csv'}: no labelled slide of a split {' or '.join(splits)}*; add some"
            )
        return folder


@dataclass(frozen=True)
class Readout:
    """A model's rows of `predictions.csv`, and the median time in ms of one window and of a one-node call beside it."""

    table: pd.DataFrame
    window_ms: float
    one_node_ms: float


def label(model: str) -> str:
    """What one of MODELS, or a bundle by its folder, is called in tables."""
    return model if model in MODELS else Path(model).resolve().name


def read_out(study: Study, model: str) -> Readout:
    """One of MODELS at every stroke fraction of every scored slide, fitted first where it is not yet; or a bundle.

    Raises:
        InputError: the model cannot be fitted to this sensor or these recordings, or the bundle is another sensor's.
    """
    of: dict[str, Any]
    make: Callable[[Study], Readout]
    match model:
        case _ if model not in MODELS:
            of, make = {"bundle": bundle_hash(Path(model))}, lambda study: _read_given(study, Path(model))
        case "inversion":
            of, make = {"map": map_settings(), "starts": asdict(STARTS)}, _read_inversion
        case "minirocket":
            of, make = {"packages": AEON}, _read_minirocket
        case _:
            bundle = _trained(study, model)
            graph = read_card(bundle / "model.json").graph_sha256
            of, make = {"graph": graph}, lambda study: _read_bundle(study, bundle, study.windows)

    def made() -> tuple[pd.DataFrame, dict[str, float]]:
        readout = make(study)
        return readout.table, {"window_ms": readout.window_ms, "one_node_ms": readout.one_node_ms}

    # A bundle has learnt nothing from this folder's calibration slides, which it need not have.
    of |= study.hashes if model in MODELS else {"scored": data_hashes(study.scored)}
    table, times = kept(study.place / label(model) / "readout", of, made)
    return Readout(table, **times)


def kept(
    place: Path, of: dict[str, Any], make: Callable[[], tuple[pd.DataFrame, dict[str, float]]]
) -> tuple[pd.DataFrame, dict[str, float]]:
    """The table and the figures of an earlier run with the same `of`; else made now."""
    table, note, of = place / "table.parquet", place / "made.json", json.loads(json.dumps(of))
    if note.exists() and (made := json.loads(note.read_text(encoding="utf-8")))["of"] == of:
        return pd.read_parquet(table), made["figures"]
    rows, figures = make()
    with staged(place) as scratch:
        rows.to_parquet(scratch / table.name)
        text = json.dumps({"of": of, "figures": figures}, indent=1)
        (scratch / note.name).write_text(text + "\n", encoding="utf-8")
    return rows, figures


def map_settings() -> dict[str, Any]:
    """The settings of the calibrated map."""
    config = CnnConfig()
    return {name: asdict(getattr(config, name)) for name in ("conditioning", "calibration", "spread")}


def _trained(study: Study, model: str) -> Path:
    """The model's bundle; a cached one if it was made from the same configuration and data."""
    bundle = study.place / model / "bundle"
    settings = json.loads(json.dumps(asdict(model_named(model).config())))
    # A bundle that cannot be read, as one of another release, is made anew.
    with suppress(InputError):
        made = read_card(bundle / "model.json").provenance
        if made["data"] == study.hashes["taught"] and made["configuration"]["settings"] == settings:
            return bundle
    return train(study.recordings, bundle, model, store=study.store).bundle


def _read_given(study: Study, bundle: Path) -> Readout:
    """A bundle that was trained elsewhere: of the folder it needs no calibration slides."""
    card = read_card(bundle / "model.json")
    windows = labelled_windows(replace(study.scored, base_motion=card.base), card.conditioning)
    return _read_bundle(study, bundle, windows)


def _read_bundle(study: Study, bundle: Path, windows: LabelledWindows) -> Readout:
    localizer = Localizer.load(bundle)

    def one(volts: np.ndarray, elapsed_s: np.ndarray) -> None:
        localizer.infer(localizer.inputs(Window(volts[0], float(elapsed_s[0]))))

    table = pd.concat(predictions(bundle, study.scored, Archive(study.jobs)), ignore_index=True)
    return Readout(table, *_times_ms(one, windows, TIMED))


def _read_inversion(study: Study) -> Readout:
    conditioning = study.calibrated.conditioning
    inversion = Inversion(study.calibrated.response, conditioning.block_s)
    sensor = study.scored.sensor
    card = window_card("inversion", inversion.outputs, sensor, conditioning, INVERSION_VALIDITY, NORMAL)
    table = window_predictions(inversion.predict, card, study.scored)
    return Readout(table, *_times_ms(inversion.predict, study.windows, TIMED_SLOW))


def _read_minirocket(study: Study) -> Readout:
    taught = regression.late_windows(labelled_windows(study.taught, study.conditioning))
    validity = Validity(offset_mm=offset_reach_mm(taught))
    card = window_card("minirocket", minirocket.OUTPUTS, study.scored.sensor, study.conditioning, validity)
    window_s = np.empty(0)

    def predict(volts: np.ndarray, elapsed_s: np.ndarray) -> np.ndarray:
        nonlocal window_s
        rows, window_s = minirocket.fit_and_predict(taught, volts)
        return rows

    table = window_predictions(predict, card, study.scored)
    _, one_node_ms = _times_ms(lambda volts, elapsed_s: None, study.windows, TIMED)
    return Readout(table, 1e3 * float(np.median(window_s)), one_node_ms)


def _times_ms(
    one: Callable[[np.ndarray, np.ndarray], object], windows: LabelledWindows, count: int
) -> tuple[float, float]:
    """Median time of `one` on single windows, volts (1, C, 64) V and elapsed_s (1,) s, and of a one-node graph.

    In turns, so that a busy machine slows both alike.
    """
    bare, times_s = one_node(), []
    for n in np.linspace(0, len(windows) - 1, count).astype(int):
        moments = [time.perf_counter()]
        one(windows.volts[n : n + 1], windows.elapsed_s[n : n + 1])
        moments.append(time.perf_counter())
        bare()
        moments.append(time.perf_counter())
        times_s.append(np.diff(moments))
    window_ms, one_node_ms = 1e3 * np.median(times_s, axis=0)
    return float(window_ms), float(one_node_ms)

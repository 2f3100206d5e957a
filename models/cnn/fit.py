"""Fits the default model: a calibrated response map, and the network trained on slides drawn from it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import onnx
import torch

from features.card import Interval, Validity
from features.stream.conditioning import Conditioning
from models.cnn.gauss_newton import Refinement
from models.cnn.network import OUTPUTS, NetworkConfig, Proposal, SlideNetwork
from models.cnn.training import TrainingConfig, train_proposal
from models.cnn.training_windows import SynthesisConfig, WindowSource
from models.fitted_model import FittedModel
from models.graph.from_torch import export_graph
from models.intervals import angle_error_deg, conformal_interval
from models.response_map.calibrate import CalibrationConfig
from models.response_map.from_atlas import DeviceSpread
from models.response_map.lag import calibrated_device
from models.response_map.map import ResponseMap
from models.response_map.select import DeviceMaps
from pipeline.atlas.atlas import Atlas
from pipeline.recordings.folder import Folder
from pipeline.recordings.windows import LabelledWindows, labelled_windows

# Without recordings nothing says how far this device is from its design: the article's own bounds, and a margin.
UNCALIBRATED = {
    "direction_deg": Interval(1.645, 4.0),
    "log_speed": Interval(1.645, 0.06),
    "offset_mm": Interval(1.645, 1.0),
}

# Without recordings nothing says either what is no slide of this sensor.
UNCALIBRATED_VALIDITY = Validity(misfit=10.0, direction_sd_deg=15.0, log_speed_sd=0.3)
# A design's proposal lies further from where a device's signal leads.
UNCALIBRATED_STEPS = 2  # more than with recordings
# A held-out window that is further off than this was lost; what it leaves over says nothing of those that were not.
ORDINARY_DEG = 20.0


@dataclass(frozen=True)
class CnnConfig:
    """Everything that decides the fit; saved with every run."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    spread: DeviceSpread = field(default_factory=DeviceSpread)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    synthesis: SynthesisConfig = field(default_factory=SynthesisConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)


def fit_cnn(
    folder: Folder,
    config: CnnConfig,
    atlas: Atlas | None = None,
    init: onnx.ModelProto | None = None,
    progress: Callable[[int, float], None] = lambda step, loss: None,
) -> FittedModel:
    """Calibrates the map on the folder's labelled slides and trains the network on it.

    folder: its calibration splits. atlas: of the sensor's design; None: from recordings alone.
    init: an exported network to go on from. progress: told the step and the loss, now and then.

    Raises:
        InputError: neither slides nor an atlas.
    """
    # At this size threads wait for each other more than they work.
    torch.set_num_threads(1)
    device = calibrated_device(folder, atlas, config.conditioning, config.calibration, config.spread)
    config, maps = replace(config, conditioning=device.conditioning), device.maps
    if not device.slides:
        refinement = replace(
            config.network.refinement, steps=config.network.refinement.steps + UNCALIBRATED_STEPS
        )
        config = replace(config, network=replace(config.network, refinement=refinement))
    response = maps.response
    source = WindowSource(response, config.conditioning.block_s, config.synthesis)
    begun = None if init is None else initial_proposal(init, response.channels, config.network)
    proposal = train_proposal(source, config.network, config.training, begun, progress)
    network = _network(proposal, response, config)
    intervals = dict(UNCALIBRATED)
    validity = UNCALIBRATED_VALIDITY
    summary = dict(maps.summary)
    if maps.held_out:
        held = _held_out(folder, maps, proposal, config)
        intervals, validity = _judge(*held)
        summary |= {f"heldout_{k}": v for k, v in _errors(*held).items()}
    return FittedModel(
        name="cnn",
        input="window",
        outputs=network.outputs,
        graph=export_graph(network, len(folder.sensor.accelerometers)),
        original=lambda inputs: _run(network, **inputs),
        intervals=intervals,
        validity=validity,
        conditioning=config.conditioning,
        summary=summary,
        windows=None if device.slides else source.draw(200, torch.Generator().manual_seed(1)).labelled(),
    )


def initial_proposal(graph: onnx.ModelProto, channels: int, config: NetworkConfig) -> Proposal:
    """The proposal network inside an exported graph.

    Raises:
        ValueError: the graph holds another network, or one for another number of channels.
    """
    found = {i.name: onnx.numpy_helper.to_array(i) for i in graph.graph.initializer}
    proposal = Proposal(channels, config)
    state = proposal.state_dict()
    for name, value in state.items():
        stored = found.get(f"proposal.{name}")
        if stored is None or stored.shape != tuple(value.shape):
            raise ValueError(
                f"proposal.{name} is missing or of another shape; name a cnn bundle of a like sensor"
            )
        state[name] = torch.tensor(stored)
    proposal.load_state_dict(state)
    return proposal


def _network(proposal: Proposal, response: ResponseMap, config: CnnConfig) -> SlideNetwork:
    refinement = Refinement(response, config.conditioning.block_s, config.network.refinement)
    return SlideNetwork(proposal, refinement).eval()


def _run(network: SlideNetwork, volts: np.ndarray, elapsed_s: np.ndarray, weight: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        row = network(*(torch.tensor(v, dtype=torch.float32) for v in (volts, elapsed_s, weight)))
    return row.numpy()


def _held_out(
    folder: Folder, maps: DeviceMaps, proposal: Proposal, config: CnnConfig
) -> tuple[np.ndarray, LabelledWindows]:
    """Rows (n, K) for windows of lines that the map behind them was not fitted to, and those windows."""
    windows = labelled_windows(folder, config.conditioning)
    rows = np.full((len(windows), len(OUTPUTS)), np.nan, dtype=np.float32)
    for response, unseen in maps.held_out:
        mask = np.isin(windows.recording, unseen)
        if mask.any():
            weight = np.ones((int(mask.sum()), windows.volts.shape[1] // 3))
            network = _network(proposal, response, config)
            found = _run(network, windows.volts[mask], windows.elapsed_s[mask], weight)
            rows[mask] = found[:, : len(OUTPUTS)]
    known = np.isfinite(rows[:, 0])
    return rows[known], windows[known]


def _judge(rows: np.ndarray, windows: LabelledWindows) -> tuple[dict[str, Interval], Validity]:
    """Intervals and validity from held-out windows."""
    column = dict(zip(OUTPUTS, rows.T.astype(float), strict=True))
    turn, speed, offset = signed_errors(rows, windows)
    late = windows.stroke_fraction > 0.35
    ordinary = late & (np.abs(turn) < ORDINARY_DEG)
    misfit = UNCALIBRATED_VALIDITY.misfit
    # A network that is lost more often than not finds its way by chance, and leaves over whatever it likes.
    if ordinary.sum() > late.sum() / 2:
        # Twice what nearly every recorded slide leaves over is a signal of something else.
        misfit = 2.0 * float(np.quantile(column["misfit"][ordinary], 0.98)) + 3.0
    validity = Validity(misfit=misfit, direction_sd_deg=6.0, log_speed_sd=0.1, offset_mm=_reach(windows))
    believed = (
        (column["misfit"] <= validity.misfit)
        & (column["direction_sd_deg"] <= validity.direction_sd_deg)
        & (column["log_speed_sd"] <= validity.log_speed_sd)
        & (np.abs(column["offset_mm"]) <= validity.offset_mm)
    )
    if believed.sum() < 20:
        return dict(UNCALIBRATED), validity
    slide = windows.recording[believed]
    return {
        "direction_deg": conformal_interval(turn[believed], column["direction_sd_deg"][believed], slide),
        "log_speed": conformal_interval(speed[believed], column["log_speed_sd"][believed], slide),
        "offset_mm": conformal_interval(offset[believed], column["offset_sd_mm"][believed], slide),
    }, validity


def _reach(windows: LabelledWindows) -> float:
    """Largest offset that the recordings can vouch for, and a little more."""
    return float(np.abs(windows.offset_mm).max()) + 1.5


def signed_errors(rows: np.ndarray, windows: LabelledWindows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Direction deg, log speed, offset mm, (n,) each, of rows (n, K) that begin with `OUTPUTS`."""
    column = dict(zip(OUTPUTS, rows.T.astype(float), strict=False))
    direction = np.degrees(np.arctan2(column["direction_sin"], column["direction_cos"]))
    return (
        angle_error_deg(direction, windows.direction_deg),
        column["log_speed"] - np.log(windows.speed_mm_s),
        column["offset_mm"] - windows.offset_mm,
    )


def _errors(rows: np.ndarray, windows: LabelledWindows) -> dict[str, float]:
    """Mean absolute errors at the whole stroke, and the share of slides whose direction is lost."""
    whole = windows.stroke_fraction > 0.99
    turn, speed, offset = (np.abs(error[whole]) for error in signed_errors(rows, windows))
    return {
        "direction_deg": float(turn.mean()),
        "lost": float((turn > ORDINARY_DEG).mean()),
        "speed_percent": float(100 * np.abs(np.expm1(speed)).mean()),
        "offset_mm": float(offset.mean()),
    }

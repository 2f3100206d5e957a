"""The device's runtime: load a bundle, push volts, read estimates. numpy and ONNX Runtime alone."""

import hashlib
import math
from pathlib import Path

import numpy as np
import onnxruntime as ort

from features.card import Card, read_card
from features.conditioning import BlockMean
from features.energy import energy_width_s
from features.errors import InputError
from features.estimate import Estimate, decode
from features.track import SlideTracker, State
from features.vector import feature_vector
from features.window import Window

GOLDEN_TOLERANCE = 1e-3


class Localizer:
    """One stream's state. The same samples give the same estimates however they are cut into chunks."""

    def __init__(self, card: Card, session: ort.InferenceSession) -> None:
        self.card = card
        self._session = session
        self._blocks = BlockMean(len(card.channels), card.samples_per_block)
        self._tracker = SlideTracker(card.conditioning, len(card.channels))
        self._weight = np.ones((1, len(card.channels) // 3), dtype=np.float32)
        self.reset()

    @classmethod
    def load(cls, bundle: Path) -> "Localizer":
        """Opens a bundle and works its golden example.

        Raises:
            InputError: the bundle is missing, altered, truncated, or does not compute what its card says.
        """
        card = read_card(bundle / "model.json")
        path = bundle / "model.onnx"
        try:
            graph = path.read_bytes()
        except OSError:
            raise InputError(f"{path}: cannot be read; a bundle holds model.onnx and model.json") from None
        if hashlib.sha256(graph).hexdigest() != card.graph_sha256:
            raise InputError(
                f"{path}: not the graph that model.json describes; take the bundle from its source again"
            )
        localizer = cls(card, open_session(graph, path))
        localizer._check_golden(path)
        return localizer

    def reset(self) -> None:
        """Forgets the stream: a new static output is awaited."""
        self._blocks.reset()
        self._tracker.reset()
        self._count = 0
        self._held: Estimate | None = None

    def feed(self, volts: np.ndarray) -> None:
        """Takes samples (n, C) V in the card's channel order without asking for estimates."""
        for block in self._blocks.push(self._checked(volts)):
            self._advance(block)

    def push(self, volts: np.ndarray) -> list[Estimate]:
        """Takes samples (n, C) V; one estimate for each block that they finish."""
        estimates = []
        for block in self._blocks.push(self._checked(volts)):
            self._advance(block)
            estimates.append(self.read())
        return estimates

    def read(self) -> Estimate:
        """The estimate as it stands, from the samples up to now."""
        state = self._tracker.state
        time_s = self._count * self.card.conditioning.block_s
        if self._held is not None:
            return self._held
        window = self._tracker.window()
        if window is None:
            return Estimate(time_s=time_s, state=state)
        row = self._session.run(None, self.inputs(window))[0][0]
        width = (
            energy_width_s(window.volts, window.elapsed_s)
            if "log_speed_width" in self.card.outputs
            else math.nan
        )
        estimate = decode(row, self.card, window, state, time_s, width)
        if state is State.ENDED:
            self._held = estimate
        return estimate

    def inputs(self, window: Window) -> dict[str, np.ndarray]:
        """The graph's inputs for one window."""
        if self.card.input == "features":
            return {"features": feature_vector(window.volts, window.elapsed_s)[None].astype(np.float32)}
        return {
            "volts": window.volts[None],
            "elapsed_s": np.array([window.elapsed_s], dtype=np.float32),
            "weight": self._weight,
        }

    def _advance(self, block: np.ndarray) -> None:
        self._tracker.push(block)
        self._count += 1
        if self._tracker.state is not State.ENDED:
            self._held = None

    def _checked(self, volts: np.ndarray) -> np.ndarray:
        volts = np.asarray(volts)
        if volts.ndim != 2 or volts.shape[1] != len(self.card.channels) or volts.dtype.kind not in "fiu":
            raise InputError(
                f"a chunk is {volts.dtype} of shape {volts.shape}; "
                f"push real numbers of shape (n, {len(self.card.channels)}) in volts"
            )
        return volts

    def _check_golden(self, path: Path) -> None:
        golden = self.card.golden
        try:
            inputs = {k: np.array(v, dtype=np.float32) for k, v in golden["inputs"].items()}
            row = self._session.run(None, inputs)[0][0]
        except Exception as error:  # ONNX Runtime raises types of its own
            raise InputError(
                f"{path}: the card's example does not run ({error}); export the bundle again"
            ) from None
        wanted = np.array(golden["estimate"], dtype=np.float32)
        if row.shape != wanted.shape or not np.allclose(
            row, wanted, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
        ):
            raise InputError(
                f"{path}: the graph does not compute its card's example; export the bundle again"
            )


def open_session(graph: bytes, path: Path) -> ort.InferenceSession:
    """One thread, no spinning: a small graph is slower on several."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.execution_mode = ort.ExecutionMode.ORT_SEQUENTIAL
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    try:
        return ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime raises types of its own
        raise InputError(f"{path}: no graph that ONNX Runtime can load ({error}); export again") from None

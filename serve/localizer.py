"""The runtime: load a bundle, push volts, read estimates. It needs numpy and ONNX Runtime alone."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnxruntime as ort

from features.angles import tilt_channels
from features.card import Card
from features.errors import InputError
from features.estimate import Estimate, decode
from features.stream.conditioning import Blocks
from features.stream.drift import UNKNOWN, DriftWatch
from features.stream.faults import BRIDGED_BLOCKS, SignalWatch
from features.stream.tracker import SlideState, SlideTracker
from features.vector.energy import energy_width_s
from features.vector.feature_vector import feature_vector
from features.window import WINDOW_BINS, Window
from serve.bundle import open_bundle
from serve.sample_slots import SampleClock

# Largest share of a slide's blocks whose means may be old ones (features/stream/faults.py); above it none is valid.
BRIDGED_SHARE = 0.05
# Blocks, 1 s, between two readings of the drift at rest; the static output's memory is 30 s.
DRIFT_BLOCKS = 50
_OUTPUT = ["estimate"]


class Localizer:
    """The localizer of one stream. The same samples give the same estimates, whatever chunks they come in.

    A bad signal never raises. Samples that are not finite or outside the supply count as lost. Where too many are
    lost, or a channel is frozen, that accelerometer is left out, or the estimate is not valid where it was the only
    one. After that its static output is learnt anew, which takes three times `trigger_blocks`.
    """

    def __init__(self, card: Card, session: ort.InferenceSession) -> None:
        self.card = card
        self._session = session
        channels, accelerometers = len(card.channels), card.sensor["accelerometers"]
        zero = np.repeat([float(a["zero_g_v"]) for a in accelerometers], 3)
        self._blocks = Blocks(channels, card.block_samples)
        self._clock = SampleClock(card.sample_rate_hz, round((BRIDGED_BLOCKS + 2) * card.block_samples))
        read = np.full(channels, card.input == "features")
        read[tilt_channels(channels)] = True
        # Without acceleration an output is half its supply, and no output is outside the supply.
        self._watch = SignalWatch(np.zeros(channels), 2.0 * zero, read)
        self._tracker = SlideTracker(card.conditioning, channels)
        self._drift = DriftWatch(accelerometers)
        self._inputs = {
            "volts": np.zeros((1, channels, WINDOW_BINS), np.float32),
            "elapsed_s": np.zeros(1, np.float32),
            "weight": np.ones((1, len(accelerometers)), np.float32),
        }
        self.reset()

    @classmethod
    def load(cls, bundle: Path) -> "Localizer":
        """Opens a bundle and checks the example of its card.

        Raises:
            InputError: the bundle is missing, altered or truncated, or does not give the result of its example.
        """
        return cls(*open_bundle(bundle))

    def reset(self) -> None:
        """Forgets the stream; the static output has to be learnt anew."""
        self._blocks.reset()
        self._clock.reset()
        self._watch.reset()
        self._tracker.reset()
        self._drift.reset()
        self._count = 0
        self._bridged = 0
        self._slide_blocks = 0
        self._whole = True
        self._healthy = np.ones(len(self.card.channels) // 3, dtype=bool)
        self._held: tuple[Window, Estimate] | None = None
        self._last_drift = UNKNOWN

    def feed(self, volts: np.ndarray, time_s: np.ndarray | None = None) -> None:
        """Takes samples as `push` does, without computing estimates."""
        for block in self._whole_blocks(volts, time_s):
            self._advance(*block)

    def push(self, volts: np.ndarray, time_s: np.ndarray | None = None) -> list[Estimate]:
        """Takes samples (n, C) V in the card's channel order; one estimate for each block that they complete.

        time_s: (n,) s, the samples' time stamps; None: each sample follows the one before. With stamps a lost sample
        leaves an empty slot. After a long gap, or when time runs back, the stream begins anew: estimates are not valid
        until the static output is known. The estimates' time_s is then of the stamps' clock.

        Raises:
            InputError: not real numbers, another shape, or a time that is not finite; no sample was taken.
        """
        estimates = []
        for block in self._whole_blocks(volts, time_s):
            self._advance(*block)
            estimates.append(self.read())
        return estimates

    def read(self) -> Estimate:
        """The estimate from the samples up to now."""
        tracker = self._tracker
        time_s = self._clock.start_s + self._count * self.card.conditioning.block_s
        window = tracker.window()
        if window is None:
            return Estimate(time_s, tracker.state, **self._last_drift._asdict())
        if tracker.state is not SlideState.ENDED:
            return self._estimate(window, time_s)
        assert self._held is not None
        return self._held[1]._replace(time_s=time_s)

    @property
    def state(self) -> SlideState:
        """What the stream shows now."""
        return self._tracker.state

    @property
    def subtracted(self) -> np.ndarray:
        """(C,) V: the last block's mean less the static output; NaN where the static output is not known."""
        known = np.repeat(self._tracker.known & self._healthy, 3)
        return np.where(known, self._tracker.subtracted, np.nan)

    def window(self) -> Window | None:
        """The window of the slide so far, or else of the last one."""
        return self._tracker.window()

    def infer(self, inputs: dict[str, np.ndarray]) -> np.ndarray:
        """The graph's output (K,) for one window's inputs."""
        return self._session.run(_OUTPUT, inputs)[0][0]

    def inputs(self, window: Window) -> dict[str, np.ndarray]:
        """The graph's inputs for one window; the next call overwrites them."""
        if self.card.input == "features":
            return {"features": feature_vector(window.volts, window.elapsed_s)[None].astype(np.float32)}
        self._inputs["volts"][0] = window.volts
        self._inputs["elapsed_s"][0] = window.elapsed_s
        self._inputs["weight"][0] = self._tracker.usable
        return self._inputs

    def _estimate(self, window: Window, time_s: float) -> Estimate:
        tracker = self._tracker
        row = self.infer(self.inputs(window))
        width = (
            float(energy_width_s(window.volts, np.asarray(window.elapsed_s)))
            if "log_speed_width" in self.card.outputs
            else math.nan
        )
        estimate = decode(row, self.card, window, tracker.state, time_s, width)
        valid = (
            estimate.valid
            and self._whole
            and tracker.moved
            and self._drift.keeps_gravity(
                tracker.static, np.add.reduce(window.volts, axis=1) / WINDOW_BINS, tracker.usable
            )
            and (self.card.input == "window" or bool(tracker.usable.all()))
        )
        return estimate._replace(
            valid=valid,
            accelerometers=tracker.usable.tolist().count(True),
            **self._last_drift._asdict(),
        )

    def _whole_blocks(
        self, volts: np.ndarray, time_s: np.ndarray | None
    ) -> Iterator[tuple[np.ndarray, tuple[float, float]]]:
        volts, time_s = self._checked(volts, time_s)
        for piece in self._clock.place(volts, time_s):
            yield from self._blocks.push(piece)

    def _advance(self, samples: np.ndarray, shares: tuple[float, float]) -> None:
        tracker = self._tracker
        sliding, usable = tracker.state is SlideState.SLIDE, tracker.usable
        judged = self._watch.push(samples, shares)
        tracker.push(judged.mean, judged.healthy)
        self._count += 1
        self._healthy = judged.healthy
        if not self._drift.complete:
            self._drift.note(tracker.static, tracker.known)
        if tracker.state is SlideState.SLIDE:
            if not sliding:
                self._bridged = self._slide_blocks = 0
            if not sliding or tracker.usable is not usable:
                # The static output stays as it is while something slides.
                self._last_drift = self._drift.read(tracker.static, tracker.usable)
            self._slide_blocks += 1
            bridged = bool((judged.bridged & tracker.usable).any())
            self._bridged += bridged
            self._whole = not bridged and self._bridged <= BRIDGED_SHARE * self._slide_blocks
        elif tracker.final is None:
            self._held = None
        elif self._held is None or self._held[0] is not tracker.final:
            # Computed as the slide ends, so that the result does not depend on when it is read.
            self._held = tracker.final, self._estimate(tracker.final, 0.0)
        if tracker.state is not SlideState.SLIDE and self._count % DRIFT_BLOCKS == 0:
            self._last_drift = self._drift.read(tracker.static, judged.healthy)

    def _checked(self, volts: np.ndarray, time_s: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
        channels = len(self.card.channels)
        volts = _numbers(volts, "a chunk")
        if volts.ndim != 2 or volts.shape[1] != channels:
            raise InputError(f"a chunk has shape {volts.shape}; push (n, {channels}) volts")
        if time_s is None:
            return volts, None
        time_s = _numbers(time_s, "time_s").astype(float)
        if time_s.shape != volts.shape[:1] or not np.isfinite(time_s).all():
            raise InputError(
                f"time_s of shape {time_s.shape} for {len(volts)} samples; push a finite time in s for each"
            )
        return volts, time_s


def _numbers(values: np.ndarray, name: str) -> np.ndarray:
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(f"{name} is ragged; push an array of real numbers") from None
    if array.dtype.kind not in "fiu":
        raise InputError(f"{name} is {array.dtype}; push real numbers")
    return array

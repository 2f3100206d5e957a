"""Streams of a sensor that nothing touches: what each kind of signal must keep."""

from pathlib import Path

import numpy as np
import pytest

from softslide.pipeline.recordings.folder import SAMPLE
from softslide.pipeline.sensor import read_sensor
from softslide.pipeline.synthesis.no_contact import LARGEST_G, REST_S, SIGNALS, untouched

SENSOR = read_sensor(Path(SAMPLE) / "sensor.toml")
STATIC_G = np.array([[0.12, -0.05, 0.99]])
STATIC_V = 1.65 + 0.8 * STATIC_G.ravel()
TIME_S = np.arange(0.0, 20.0, 0.005)
OF_GRAVITY = ("rest", "tilt", "rocking", "pressure")


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kind", SIGNALS)
def test_a_signal_begins_at_rest_and_stays_within_its_size(kind: str, seed: int) -> None:
    signal = SIGNALS[kind](STATIC_G, TIME_S, np.random.default_rng(seed))
    assert signal.shape == (1, 3, len(TIME_S))
    assert np.isfinite(signal).all()
    largest = np.abs(signal[:, :2]).max()
    # No sudden jump: nothing of the signal shows in its first sample but what one step of it can.
    assert np.abs(signal[..., 0]).max() <= 0.02 * max(largest, 1e-9)
    if kind in OF_GRAVITY:
        length = np.linalg.norm(STATIC_G[:, :, None] + signal, axis=1)
        assert length == pytest.approx(np.linalg.norm(STATIC_G))
    else:
        assert LARGEST_G[0] * 0.99 <= largest <= LARGEST_G[1] * 1.01
    if kind == "swaying":
        assert not signal[:, 2].any()


@pytest.mark.parametrize("kind", SIGNALS)
def test_v_z_stays_in_some_streams_and_moves_in_others(kind: str) -> None:
    signals = [SIGNALS[kind](STATIC_G, TIME_S, np.random.default_rng(seed)) for seed in range(12)]
    moves = {bool(signal[:, 2].any()) for signal in signals}
    expected = {"rest": {False}, "swaying": {False}, "tilt": {True}, "rocking": {True}, "pressure": {True}}
    assert moves == expected.get(kind, {True, False})


def test_a_stream_rests_first_and_is_the_same_for_the_same_seed() -> None:
    streams = [
        untouched(SENSOR, STATIC_V, SIGNALS["bumps"], 2.0, np.random.default_rng(seed)) for seed in (1, 1, 2)
    ]
    rate = SENSOR.sample_rate_hz
    assert streams[0].shape == (round((REST_S + 2.0) * rate), 3)
    assert (streams[0] == streams[1]).all()
    assert not (streams[0] == streams[2]).all()
    rest = streams[0][: round(REST_S * rate)]
    assert rest.mean(axis=0) == pytest.approx(STATIC_V, abs=2e-3)

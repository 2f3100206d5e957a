"""The skin's lag is undone in a whole recording as it is in a stream."""

import numpy as np
import pytest

from softslide.features.stream.conditioning import Conditioning, without_lag
from softslide.features.stream.slide_history import SlideHistory


def output(blocks: int) -> np.ndarray:
    """Block means (n, 6) V of a random walk, from a seed."""
    return 1.6 + 0.01 * np.random.default_rng(3).standard_normal((blocks, 6)).cumsum(axis=0)


@pytest.mark.parametrize(("delayed", "tau_s"), [(0.0, 0.15), (0.1, 0.05), (0.4, 0.6)])
def test_whole_and_stream_agree(delayed: float, tau_s: float) -> None:
    blocks, conditioning = output(200), Conditioning(delayed=delayed, tau_s=tau_s)
    history = SlideHistory(conditioning, blocks[0], np.ones(2, dtype=bool))
    for block in blocks:
        history.push(block)
    streamed = history.first_blocks(200)
    assert streamed is not None
    whole = (without_lag(blocks, conditioning) - blocks[0])[:, history.watched]
    np.testing.assert_allclose(streamed.T, whole, atol=1e-12)
    assert (delayed == 0) == np.allclose(whole, (blocks - blocks[0])[:, history.watched], atol=1e-6)


def test_a_step_comes_late_by_the_lag_and_a_constant_stays() -> None:
    conditioning = Conditioning(delayed=0.2, tau_s=0.3)
    assert np.array_equal(without_lag(np.full((50, 3), 1.65), conditioning), np.full((50, 3), 1.65))
    ramp = np.outer(np.arange(400.0) * conditioning.block_s, np.ones(3))
    # A steady change of 1 V/s, seen late by lag_s, was ahead by 1 V/s times lag_s.
    ahead = (without_lag(ramp, conditioning) - ramp)[-1]
    assert ahead == pytest.approx(conditioning.lag_s, rel=1e-3)

"""The skin's lag: what the simulator's solid puts on, a slide's history is free of, and calibration finds."""

from dataclasses import replace

import numpy as np
import pytest
from bump_map import bump_map
from calibration_slides import slides_of

from softslide.features.stream.conditioning import Conditioning, block_means, without_lag
from softslide.features.stream.slide_history import SlideHistory
from softslide.features.stream.tracker import track
from softslide.models.response_map.slide_fit import TAU_S, retardation_s
from softslide.models.response_map.slides import CalibrationSlide
from softslide.pipeline.synthesis.viscoelastic_lag import standard_solid

DELAYED, TAUS = 0.15, (0.05, 0.2, 0.6)


def window_of(signal: np.ndarray, conditioning: Conditioning, end: int) -> tuple[np.ndarray, np.ndarray]:
    """A signal (n, 3) V at 1 kHz: its window's bins (3, 64) V when `end` samples were seen, and the bins' edges."""
    blocks = block_means(signal, Conditioning(), 1000.0)
    (window,) = track(blocks, conditioning, np.array([end // 20]))
    assert window is not None
    return window.volts, end - 1000 * window.elapsed_s * np.linspace(1, 0, 65)


@pytest.mark.parametrize("tau_s", TAUS)
def test_a_slides_history_is_free_of_the_lag(tau_s):
    t = np.arange(0, 8, 1e-3) - 6.0
    bell = np.exp(-((t / 0.6) ** 2))
    still = np.stack([-0.4 * t * bell, 0.15 * bell, 0 * t], axis=1)
    lagging = standard_solid(still, 1e-3, DELAYED, tau_s)
    errors = []
    for conditioning in (Conditioning(), Conditioning(delayed=DELAYED, tau_s=tau_s)):
        volts, edges = window_of(lagging, conditioning, 6800)
        integral = np.concatenate([np.zeros((1, 3)), np.cumsum(still, axis=0)])
        means = np.diff([np.interp(edges, np.arange(len(integral)), c) for c in integral.T]) / np.diff(edges)
        errors.append(np.abs(volts - means).max())
    left, undone = errors
    assert undone < 5e-4
    assert left > 2e-3


def slides_with(tau_s: float, speeds: np.ndarray) -> list[CalibrationSlide]:
    """Noisy slides over the formula's map with a solid's lag."""
    random = np.random.default_rng(1)
    lines = [(90.0 * (n % 4), random.uniform(-10, 10)) for n in range(len(speeds))]
    return [
        replace(
            slide,
            volts=standard_solid(slide.volts, slide.step_s, DELAYED, tau_s)
            + 1.4e-3 / np.sqrt(slide.blocks) * random.standard_normal(slide.volts.shape),
        )
        for slide in slides_of(bump_map(), lines, speeds, np.ones(len(speeds)))
    ]


@pytest.mark.parametrize("tau_s", TAUS)
def test_fast_slides_tell_how_the_lag_is_spread(tau_s):
    slides = slides_with(tau_s, np.geomspace(1.0, 12.0, 40))
    lag_s = DELAYED * tau_s
    known = replace(bump_map(), lag_s=lag_s)
    found = retardation_s(slides, [(known, np.array([s.recording for s in slides]))], lag_s)
    assert tau_s / 1.6 < found < tau_s * 1.6


def test_slow_slides_and_none_leave_it_to_the_prior():
    slides = slides_with(0.05, np.full(12, 0.5))
    known = replace(bump_map(), lag_s=DELAYED * 0.05)
    assert retardation_s(slides, [(known, np.array([s.recording for s in slides]))], known.lag_s) == TAU_S
    assert retardation_s(slides, [], known.lag_s) == TAU_S


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

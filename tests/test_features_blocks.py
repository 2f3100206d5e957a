"""Blocks are a time, whatever the rate: exact edges, no drift, mains cancelled, nothing that depends on chunks."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from resampled import resampled_folder

from softslide.features.stream.conditioning import Blocks, Conditioning, block_mean, block_means, blocks_in
from softslide.features.stream.faults import FROZEN_BLOCKS, SignalWatch, frozen_blocks
from softslide.models.response_map.slides import calibration_slides
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.windows import labelled_windows

CONDITIONING = Conditioning()
RATES_HZ = (100.0, 128.0, 333.0, 1024.0, 25_600.0, 100_000.0)


@pytest.mark.parametrize("rate_hz", [100.0, 350.0, 1000.0, 25_600.0])
def test_whole_blocks_are_plain_means(rate_hz: float) -> None:
    volts = np.random.default_rng(1).normal(1.6, 0.1, (round(2.03 * rate_hz), 3))
    size = round(0.02 * rate_hz)
    whole = len(volts) // size
    plain = volts[: whole * size].reshape(whole, size, 3).mean(axis=1)
    assert np.array_equal(block_means(volts, CONDITIONING, rate_hz), plain)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_a_bell_after_half_a_minute_is_where_it_is(rate_hz: float) -> None:
    """Its centre of mass in the blocks' times: at 333 Hz blocks of 7 samples would put it 1.3 s off."""
    time_s = (np.arange(round(32 * rate_hz)) + 0.5) / rate_hz
    bell = np.exp(-0.5 * ((time_s - 27.0) / 0.5) ** 2)
    means = block_means(bell[:, None], CONDITIONING, rate_hz)[:, 0]
    middle_s = (np.arange(len(means)) + 0.5) * CONDITIONING.block_s
    assert (middle_s @ means) / means.sum() == pytest.approx(27.0, abs=1e-4)
    assert blocks_in(np.array([len(time_s)]), CONDITIONING.block_samples(rate_hz))[0] == len(means) == 1600


@pytest.mark.parametrize("rate_hz", [128.0, 333.0, 1024.0, 1000.0 / 3])
def test_blocks_do_not_depend_on_chunks(rate_hz: float) -> None:
    rng = np.random.default_rng(2)
    volts = rng.normal(1.6, 0.1, (2000, 3))
    whole = block_means(volts, CONDITIONING, rate_hz)
    blocks = Blocks(3, CONDITIONING.block_samples(rate_hz))
    cuts = np.sort(rng.integers(0, len(volts), 300))
    streamed = [block_mean(*block) for chunk in np.split(volts, cuts) for block in blocks.push(chunk)]
    assert np.array_equal(np.array(streamed), whole)


@pytest.mark.parametrize(
    ("rate_hz", "passed"), [(128.0, 0.15), (333.0, 0.02), (1024.0, 0.005), (25_600.0, 1e-6)]
)
def test_mains_is_cancelled(rate_hz: float, passed: float) -> None:
    """Largest share of a tone of 50 Hz; whole samples a block pass 0.18, 0.05, 0.02 of it (rms) at the first three."""
    tone = np.sin(2 * np.pi * 50 * np.arange(round(20 * rate_hz)) / rate_hz + 0.3)
    assert np.abs(block_means(tone[:, None], CONDITIONING, rate_hz)).max() < passed


@pytest.mark.parametrize(("noise_steps", "lasts"), [(0.15, True), (0.3, True), (0.5, False), (3.0, False)])
def test_a_working_channel_of_a_coarse_converter_is_not_frozen(noise_steps: float, lasts: bool) -> None:
    """Two samples a block, as at 100 Hz; the output in the middle of a step. One that does not change at all is."""
    own = np.random.default_rng(0).normal(0.0, noise_steps, (40_000, 2, 3))
    most = frozen_blocks(1.0, math.sqrt(noise_steps**2 + 1 / 12), 2)
    assert (most > FROZEN_BLOCKS) is lasts
    watch = SignalWatch(np.full(3, -1e6), np.full(3, 1e6), np.ones(3, dtype=bool), most)
    moving = np.arange(2)[:, None] * [0, 0, 1]  # V_z changes all the time
    assert all(watch.push(block).healthy.all() for block in np.round(own) + moving)
    watch.reset()
    healthy = [
        watch.push(np.round(block) * [0, 1, 1] + moving).healthy.all() for block in own[: round(most) + 2]
    ]
    assert np.argmin(healthy) == pytest.approx(most, abs=1)


def test_a_converter_whose_steps_hide_the_noise_is_never_frozen_and_an_unknown_one_as_ever() -> None:
    assert frozen_blocks(5e-3, 5e-3 / np.sqrt(12), 2) == np.inf
    assert frozen_blocks(0.0, 5e-3, 20) == FROZEN_BLOCKS


def test_a_lost_sample_at_an_edge_leaves_the_mean() -> None:
    watch = SignalWatch(np.zeros(3), np.full(3, 3.3), np.ones(3, dtype=bool))
    volts = np.full((700, 3), 1.65) + np.random.default_rng(3).normal(0.0, 1e-6, (700, 3))
    volts[::13] = np.nan
    for samples, shares in Blocks(3, CONDITIONING.block_samples(333.0)).push(volts):
        judged = watch.push(samples, shares)
        assert judged.mean == pytest.approx(np.full(3, 1.65), abs=1e-5)
        assert judged.healthy.all()


@pytest.mark.parametrize("rate_hz", [128.0, 333.0, 1024.0])
def test_a_slide_is_the_same_at_every_rate(rate_hz: float, tmp_path: Path) -> None:
    """Windows, and places of the calibration's stretches, agree within a tenth of a block's noise of 1.1 mV."""
    sample = read_folder(SAMPLE)
    some = replace(sample, manifest=sample.manifest.iloc[[0, 1]])
    other = resampled_folder(some, rate_hz, tmp_path / "lab")
    usual, found = (labelled_windows(folder, CONDITIONING) for folder in (some, other))
    assert found.recording.tolist() == usual.recording.tolist()
    assert found.elapsed_s == pytest.approx(usual.elapsed_s, abs=0.021)
    same = np.isclose(found.elapsed_s, usual.elapsed_s)
    assert same.mean() > 0.8
    assert np.sqrt(np.mean((found.volts - usual.volts)[same] ** 2)) < 1.1e-4
    for a, b in zip(*(calibration_slides(folder, CONDITIONING) for folder in (some, other)), strict=True):
        assert b.travelled_mm[-1] == pytest.approx(a.travelled_mm[-1], abs=1e-6)
        assert np.sqrt(np.mean((b.volts - a.volts) ** 2)) < 1.1e-4

"""What the health report measures of one recording: clipping, tones, and the signs that its labels are due."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from softslide.pipeline.checks.findings import Limits
from softslide.pipeline.checks.measurements import Measurements, measure
from softslide.pipeline.checks.rail_run import MOST_AT_RAIL, rail_run
from softslide.pipeline.checks.zone_signs import sign_agreement
from softslide.pipeline.recordings.folder import SAMPLE, Recording, read_folder


@pytest.mark.parametrize("rate_hz", [100.0, 250.0, 1000.0])
@pytest.mark.parametrize("noise_steps", [0.0, 0.3, 1.0])
def test_a_smooth_peak_that_is_read_in_steps_is_not_clipped(rate_hz: float, noise_steps: float) -> None:
    """As by a converter of 10 bits, 5 mV, whose steps are larger than the noise; cut at 0.6 of its height it is."""
    random, sound, clipped = np.random.default_rng(0), 0, 0
    for _ in range(100):
        width_s, steps = random.uniform(0.3, 3.0), random.uniform(30, 200)
        time_s = np.arange(0.0, 8.0 * width_s, 1.0 / rate_hz) / width_s - 4.0
        smooth = steps * time_s * np.exp((1.0 - time_s**2) / 2)
        noise = random.uniform() + random.normal(0.0, noise_steps, len(time_s))
        sound += rail_run(np.round(smooth + noise)) <= MOST_AT_RAIL
        clipped += rail_run(np.round(np.minimum(smooth + noise, 0.6 * smooth.max()))) > MOST_AT_RAIL
    assert sound >= 99
    assert clipped >= 97


def unlabelled(volts: np.ndarray, rate_hz: float) -> Measurements:
    """What is measured of outputs (n, 3) V about 1.65 V, of which no motion is known."""
    folder, time_s = read_folder(SAMPLE), np.arange(len(volts)) / rate_hz
    labels = folder.manifest.iloc[0].copy()
    labels["motion_start_s"] = labels["motion_end_s"] = np.nan
    sensor = replace(folder.sensor, sample_rate_hz=rate_hz)
    return measure(Recording("one", time_s, 1.65 + volts), labels, sensor)


@pytest.mark.parametrize(("rate_hz", "hz", "mains"), [(100, 60, True), (200, 180, True), (100, 67, False)])
def test_mains_that_the_sampling_folds_are_neither_a_tone_nor_a_repetition(
    rate_hz: float, hz: float, mains: bool
) -> None:
    """At 100 Hz 60 are read as 40."""
    time_s = np.arange(20 * rate_hz) / rate_hz
    noise = np.random.default_rng(0).normal(0.0, 0.001, (len(time_s), 3))
    figures = unlabelled(noise + 0.004 * np.sin(2 * np.pi * hz * time_s + 0.1)[:, None], rate_hz)
    assert (figures.tone_ratio.max() > Limits.tone) != mains
    assert (figures.echo.max() > Limits.echo) != mains


@pytest.mark.parametrize("hz", [50.0, 60.0])
@pytest.mark.parametrize("ringing_hz", [48.0, 57.0])
def test_a_skin_that_vibrates_near_the_mains_does_not_pick_it_up(ringing_hz: float, hz: float) -> None:
    """Noise of 10 mV through a resonance is not read as mains of half that; a sine of 10 mV on top is, to 15 %."""
    rate_hz, radius = 1000.0, 0.97
    time_s, turn = np.arange(30 * rate_hz) / rate_hz, 2 * np.pi * ringing_hz / rate_hz
    white = np.random.default_rng(0).normal(0.0, 1.0, (len(time_s), 3))
    rung = lfilter([1.0], [1.0, -2 * radius * np.cos(turn), radius**2], white, axis=0)
    rung *= 0.01 / rung.std(axis=0)
    assert unlabelled(rung, rate_hz).mains_v.max() < 0.005
    figures = unlabelled(rung + 0.01 * np.sin(2 * np.pi * hz * time_s + 0.1)[:, None], rate_hz)
    assert figures.mains_hz == hz
    assert figures.mains_v == pytest.approx(0.01, rel=0.15)


@pytest.mark.parametrize(("off_mm", "compared"), [(-6.0, True), (-4.0, False), (4.0, False), (6.0, True)])
def test_no_sign_is_due_where_a_slide_passes_next_to_a_board(off_mm: float, compared: bool) -> None:
    """Along x past the sample's board, which lies at y = 0; off the centre an output turns next to its board."""
    folder = read_folder(SAMPLE)
    labels = folder.manifest.loc["a0032"].copy()
    labels[["offset_mm", "start_x_mm", "start_y_mm"]] = off_mm, np.nan, np.nan
    agreement, _ = sign_agreement(folder.load("a0032"), labels, folder.sensor)
    assert np.isfinite(agreement[0, 1, 1]) == compared
    assert np.isfinite(agreement[0, 0, 0])

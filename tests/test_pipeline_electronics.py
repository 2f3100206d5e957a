"""The electronics by law: what the output's spectrum, steps and rails show is what the data sheet says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import freqz, welch

from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.sensor import NOISE_G_RTHZ, Accelerometer, read_sensor
from softslide.pipeline.synthesis.electronics import (
    BANDWIDTH_HZ,
    SUPPLY_V,
    ElectronicsSpread,
    digitized,
    draw_electronics,
    ideal_electronics,
    low_pass_pole,
    volts,
)

SENSOR = read_sensor(DEFAULT_SENSOR)
IDEAL = replace(ideal_electronics(SENSOR), adc_step_v=0.0)
NOISY = replace(IDEAL, noise_g_rthz=np.full((1, 3), NOISE_G_RTHZ["MMA7361L"]), bandwidth_hz=BANDWIDTH_HZ)


def random(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def upright(count: int, boards: int = 1) -> np.ndarray:
    return np.broadcast_to(np.array([0.0, 0.0, 1.0])[:, None], (boards, 3, count)).copy()


def test_gravity_becomes_volts_by_the_sensor_s_own_figures():
    gravity = random().uniform(-1, 1, (1, 3, 50))
    assert np.allclose(volts(gravity, IDEAL, random()), 1.65 + 0.8 * gravity[0].T, atol=1e-6)


def test_the_spectrum_has_the_data_sheet_s_density_and_bandwidth():
    output = volts(upright(300_000), NOISY, random(1))
    frequency, power = welch(output, 1000.0, nperseg=500, axis=0)
    low = power[(frequency >= 4) & (frequency <= 40)].mean(axis=0)
    assert np.sqrt(low) / 0.8 == pytest.approx(350e-6, rel=0.03)
    for axis, bandwidth in enumerate((400, 400, 300)):
        near = power[np.abs(frequency - bandwidth) <= 12, axis].mean()
        assert near / low[axis] == pytest.approx(0.5, rel=0.06)
    # The bandwidths differ: z is below a half at 400 Hz.
    assert power[np.abs(frequency - 400) <= 12, 2].mean() / low[2] < 0.42


@pytest.mark.parametrize(("bandwidth", "rate"), [(400, 1000), (300, 1000), (20, 1000), (400, 5000)])
def test_the_low_pass_halves_the_power_at_the_bandwidth(bandwidth, rate):
    pole = low_pass_pole(bandwidth, rate)
    _, response = freqz([1 - pole], [1, -pole], [0, bandwidth], fs=rate)
    assert np.abs(response) ** 2 == pytest.approx([1, 0.5])
    assert low_pass_pole(bandwidth, bandwidth) == 0


def test_noise_is_stationary_from_the_first_sample():
    boards = 20_000
    each = {"volts_per_g": IDEAL.volts_per_g, "zero_v": np.full((1, 3), 1.65), "mains_v": np.zeros((3, 4))}
    each["noise_g_rthz"] = NOISY.noise_g_rthz
    parts = {name: np.repeat(one, boards, 0) for name, one in each.items()}
    many = replace(NOISY, bandwidth_hz=(400.0, 50.0, 300.0), **parts)
    tilted = upright(6, boards)
    tilted[:, 1] = 0.5
    output = volts(tilted, many, random(2))
    by_axis = output.reshape(6, boards, 3)
    assert by_axis.mean(axis=1) == pytest.approx(np.tile([1.65, 2.05, 2.45], (6, 1)), abs=3e-4)
    spread = by_axis.std(axis=1)
    assert spread[0] == pytest.approx(spread[5], rel=0.03)


def test_the_adc_has_steps_and_rails():
    output = volts(upright(2000), replace(NOISY, adc_step_v=5e-4), random(3))
    steps = output / 5e-4
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    assert len(np.unique(output[:, 0])) > 20
    ramp = np.linspace(-1, 5, 1001, dtype=np.float32)
    assert digitized(ramp, 5e-4).min() == 0
    assert digitized(ramp, 5e-4).max() == pytest.approx(SUPPLY_V)
    inside = (ramp > 0) & (ramp < SUPPLY_V)
    assert np.abs(digitized(ramp, 0.1) - ramp)[inside].max() == pytest.approx(0.05, abs=5e-3)
    assert np.array_equal(digitized(ramp, 0.0)[inside], ramp[inside])


def test_mains_has_its_amplitude_frequency_and_third_harmonic():
    waves = np.zeros((3, 4))
    waves[0, 0], waves[1, 1], waves[2, 2] = 1e-3, 2e-3, 3e-3
    output = volts(upright(10_000), replace(IDEAL, mains_v=waves), random(4))
    spectrum = np.abs(np.fft.rfft(output - output.mean(axis=0), axis=0)) / 5000
    assert np.argmax(spectrum, axis=0).tolist() == [500, 500, 1500]
    assert spectrum.max(axis=0) == pytest.approx([1e-3, 2e-3, 3e-3], rel=1e-3)


def test_a_seed_draws_one_device_within_the_data_sheet():
    sensor = replace(SENSOR, accelerometers=tuple(Accelerometer(f"a{n}", 0.0, 0.0) for n in range(300)))
    one, same = (draw_electronics(sensor, ElectronicsSpread(), random(5)) for _ in range(2))
    other = draw_electronics(sensor, ElectronicsSpread(), random(6))
    assert np.array_equal(one.volts_per_g, same.volts_per_g)
    assert not np.array_equal(one.volts_per_g, other.volts_per_g)
    diagonal = one.volts_per_g[:, range(3), range(3)]
    assert diagonal.mean() == pytest.approx(0.8, rel=0.003)
    assert diagonal.std() == pytest.approx(0.008, rel=0.1)
    # Data sheet: 0.74 to 0.86 V/g, 1.485 to 1.815 V, 5 % of cross-axis.
    assert 0.74 < diagonal.min() < diagonal.max() < 0.86
    assert 1.485 < one.zero_v.min() < one.zero_v.max() < 1.815
    amplitude = np.hypot(one.mains_v[:, 0], one.mains_v[:, 1])
    assert 0.8 * 0.0003 < amplitude.min() < amplitude.max() < 0.8 * 0.002
    assert np.hypot(one.mains_v[:, 2], one.mains_v[:, 3]) == pytest.approx(0.2 * amplitude)

"""The signal path fits the sensor: its sensitivity, its mains, its noise. The sample's own stays as it is."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_bundle import write_small_bundle
from streams import a_sensor, pass_over, still, stream

from softslide.features.stream.conditioning import Conditioning, block_means
from softslide.models.response_map.slides import calibration_slides
from softslide.pipeline.recordings.at_rest import conditioning_for
from softslide.pipeline.recordings.folder import SAMPLE, Folder, Recording, read_folder, write_folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.pipeline.sensor import Sensor, read_sensor, write_sensor
from softslide.serve.localizer import Localizer

Change = Callable[[Recording], np.ndarray]


def some() -> Folder:
    sample = read_folder(SAMPLE)
    return replace(sample, manifest=sample.manifest.iloc[[0, 5, 9]])


def changed(root: Path, volts_of: Change, sensor: Sensor | None = None) -> Folder:
    """Three of the sample's slides with other volts, and perhaps another sensor."""
    folder = some()
    recordings = (folder.load(str(name)) for name in folder.manifest.index)
    slides = (Recording(r.name, r.time_s, volts_of(r)) for r in recordings)
    return write_folder(root, sensor or folder.sensor, folder.manifest, slides)


def with_tone(hz: float, amplitude_v: float) -> Change:
    return lambda r: r.volts + amplitude_v * np.sin(2 * np.pi * hz * r.time_s)[:, None]


def test_the_samples_signal_path_is_the_default() -> None:
    """But for what its slides show of gravity's length."""
    found = conditioning_for(some(), Conditioning())
    assert 0.006 <= found.gravity_sd_g < 0.01
    assert found == Conditioning(gravity_sd_g=found.gravity_sd_g)
    chosen = Conditioning(block_s=0.04, delayed=0.1, scale=1.5, gravity_sd_g=0.02)
    assert conditioning_for(some(), chosen) == chosen


@pytest.mark.parametrize(
    ("hz", "amplitude_v", "block_s"),
    [(60.0, 0.01, 1 / 60), (50.0, 0.01, 0.02), (60.0, 0.001, 0.02), (55.0, 0.01, 0.02)],
)
def test_mains_is_found_at_rest(hz: float, amplitude_v: float, block_s: float, tmp_path: Path) -> None:
    folder = changed(tmp_path / "lab", with_tone(hz, amplitude_v))
    assert conditioning_for(folder, Conditioning()).block_s == pytest.approx(block_s)


def test_mains_of_60_hz_is_cancelled(tmp_path: Path) -> None:
    """Blocks of the mains' period leave a slide as it is without mains; blocks of 20 ms do not."""
    lab = changed(tmp_path / "lab", with_tone(60.0, 0.03))
    fitting = conditioning_for(lab, Conditioning())
    left = {}
    for name, path in (("fitting", fitting), ("default", Conditioning())):
        pairs = ((lab.load(str(n)).volts, some().load(str(n)).volts) for n in lab.manifest.index)
        gaps = [block_means(a, path, 1000.0) - block_means(b, path, 1000.0) for a, b in pairs]
        left[name] = float(np.sqrt(np.mean(np.concatenate(gaps) ** 2)))
    assert left["fitting"] < 1e-4
    assert left["default"] > 2e-3


def test_mains_named_in_the_sensor_counts(tmp_path: Path) -> None:
    folder = some()
    named = replace(folder, sensor=replace(folder.sensor, mains_hz=60.0))
    assert conditioning_for(named, Conditioning()).block_s == pytest.approx(1 / 60)
    write_sensor(tmp_path / "sensor.toml", named.sensor)
    assert read_sensor(tmp_path / "sensor.toml") == named.sensor
    with pytest.raises(ValueError, match="50 or 60"):
        replace(folder.sensor, mains_hz=55.0)


def test_another_sensitivity_gives_the_same_windows_and_slides(tmp_path: Path) -> None:
    """The sample at 0.2 V/g: a quarter of the volts, noise too."""
    lab = changed(tmp_path / "lab", lambda r: r.volts / 4, some().sensor.scaled(0.25))
    path = conditioning_for(lab, Conditioning())
    alike = conditioning_for(some(), Conditioning()).gravity_sd_g
    assert path.gravity_sd_g == pytest.approx(alike, rel=1e-6)
    assert path == Conditioning(scale=4.0, gravity_sd_g=path.gravity_sd_g)
    usual, found = labelled_windows(some()), labelled_windows(lab, path)
    assert found.elapsed_s.tolist() == usual.elapsed_s.tolist()
    assert found.volts == pytest.approx(usual.volts, abs=1e-6)
    for a, b in zip(calibration_slides(some(), Conditioning()), calibration_slides(lab, path), strict=True):
        assert b.volts == pytest.approx(a.volts, abs=1e-9)
    assert lab.sensor.scaled(path.scale).accelerometers[0].sensitivity_v_per_g == pytest.approx(0.8)


def test_the_device_reads_another_sensitivity_alike(tmp_path: Path) -> None:
    usual = a_sensor()
    part = replace(usual.accelerometers[0], sensitivity_v_per_g=0.2)
    device = Localizer.load(write_small_bundle(tmp_path / "a", usual, offset_mm_per_v=50.0))
    card = replace(
        device.card,
        sensor=device.card.sensor | {"accelerometers": [vars(part)]},
        conditioning=replace(device.card.conditioning, scale=4.0),
    )
    other = Localizer(card, device._session)
    volts = stream(still(1.0), pass_over(2.0), still(0.5))
    pairs = list(zip(device.push(volts), other.push(1.65 + (volts - 1.65) / 4), strict=True))
    assert any(a.valid for a, _ in pairs)
    for a, b in pairs:
        assert (b.state, b.valid) == (a.state, a.valid)
        assert b.offset_mm == pytest.approx(a.offset_mm, abs=1e-4, nan_ok=True)
        assert b.gain == pytest.approx(a.gain, nan_ok=True)
        # In the sensor's own volts.
        assert 4 * b.zero_shift_v == pytest.approx(a.zero_shift_v, abs=1e-9, nan_ok=True)
    assert 4 * other.subtracted == pytest.approx(device.subtracted, abs=1e-9)


def test_thresholds_grow_with_the_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    lab = changed(tmp_path / "lab", lambda r: r.volts + rng.normal(0.0, 0.03, r.volts.shape))
    path, usual = conditioning_for(lab, Conditioning()), Conditioning()
    # Blocks of 20 samples, means of 5 blocks: 3 mV, and six of these.
    assert path.trigger_v == pytest.approx(6 * 0.03 / np.sqrt(100), rel=0.25)
    for name in ("release_v", "calm_v", "still_peak_v"):
        assert getattr(path, name) / getattr(usual, name) == pytest.approx(path.trigger_v / usual.trigger_v)

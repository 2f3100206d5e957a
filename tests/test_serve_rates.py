"""A bundle reads its sensor at other sample rates: the same blocks, the same estimates."""

from pathlib import Path

import numpy as np
import pytest
from streams import write_csv

import softslide
from softslide.features.errors import InputError
from softslide.serve.localizer import Localizer

LENGTH_S = 8.0


def volts_at(time_s: np.ndarray) -> np.ndarray:
    """Rest, then a slide whose outputs rise and fall over 4 s; no noise."""
    way = np.clip((time_s - 3.0) / 4.0, 0.0, 1.0)
    bump = np.sin(np.pi * way) ** 2
    return np.array([1.65, 1.65, 2.45]) + np.column_stack([0.2 * bump * (way - 0.5), 0.1 * bump, 0.0 * way])


def written(path: Path, rate_hz: float) -> Path:
    return write_csv(path, volts_at(np.arange(int(LENGTH_S * rate_hz)) / rate_hz), rate_hz=rate_hz)


@pytest.mark.parametrize("rate_hz", [1000 / 3, 500.0, 1024.0, 10_000.0])
def test_a_recording_at_another_rate_gives_the_same(
    bundle: Path, tmp_path: Path, rate_hz: float, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = list(softslide.predict(bundle, written(tmp_path / "a.csv", 1000.0), track=True))
    assert capsys.readouterr().err == ""
    found = list(softslide.predict(bundle, written(tmp_path / "b.csv", rate_hz), track=True))
    assert capsys.readouterr().err.startswith(f"samples at {rate_hz:.6g} Hz are read")
    assert abs(len(found) - len(wanted)) <= 1
    assert sum(line["valid"] for line in wanted) > 50
    for one, other in zip(wanted[:-2], found, strict=False):
        assert one["state"] == other["state"]
        assert one["time_s"] == pytest.approx(other["time_s"], abs=0.004)
        if one["valid"] and other["valid"]:
            assert one["offset_mm"] == pytest.approx(other["offset_mm"], abs=0.05)


def test_a_live_stream_at_another_rate_is_named(bundle: Path) -> None:
    slow = Localizer.load(bundle, rate_hz=500.0)
    time_s = np.arange(int(LENGTH_S * 500)) / 500
    assert len(slow.push(volts_at(time_s))) == LENGTH_S / 0.02
    with pytest.raises(InputError, match=r"rate_hz 120 Hz is not read: .* at 250 to 100000 Hz"):
        Localizer.load(bundle, rate_hz=120.0)


def test_each_rate_is_said_next_to_the_calibration_s(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [written(tmp_path / f"{n}.csv", rate_hz) for n, rate_hz in enumerate((500.0, 500.0, 2000.0))]
    assert len(list(softslide.predict(bundle, files))) == 3
    said = capsys.readouterr().err.splitlines()
    assert said == [f"samples at {rate} Hz are read (calibrated at 1000 Hz)" for rate in (500, 2000)]

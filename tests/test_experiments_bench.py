"""Benchmarks of making data: figures by name, and what cannot be had is said; no claim about this machine."""

from pathlib import Path

import pytest

from experiments.bench.skin import features_of_a_window


def test_features_are_timed_and_without_an_environment_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("SOFTSLIDE_CACHE", str(tmp_path / "file"))
    figures = features_of_a_window()
    assert set(figures) == {"features_ms", "features_of_all_samples_ms", "features_one_window_at_a_time_ms"}
    assert 0 < figures["features_ms"] < figures["features_one_window_at_a_time_ms"]
    assert "features are not compared" in capsys.readouterr().err

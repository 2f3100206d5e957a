"""A lab's first day, end to end: from its own files to a verdict, with the commands that the guide shows."""

from pathlib import Path

import pytest
from test_pipeline_guess import german

import softslide

pytestmark = pytest.mark.long


def test_from_a_lab_s_files_to_five_bounds_met(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lab = german(tmp_path, count=60)

    def run(*words: object) -> str:
        assert softslide.main([str(word) for word in words]) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    map_path = tmp_path / "map.toml"
    map_path.write_text(run("import", "--guess", lab).replace('"zones"', '"given"'))
    folder, model, results = tmp_path / "mine", tmp_path / "model", tmp_path / "results"
    assert "60 recordings imported" in run("import", lab, "--map", map_path, "--out", folder)
    assert "60 recordings, 0 errors" in run("check", folder)
    run("train", "--recordings", folder, "--out", model)
    said = run("evaluate", "--model", model, "--recordings", folder, "--out", results, "--allow-untested")
    verdicts = said.splitlines()[:6]
    assert sum(": met" in line for line in verdicts) == 5, said
    run("recalibrate", "--model", model, "--recordings", folder, "--out", tmp_path / "renewed")
    raw = sorted(lab.rglob("*.csv"))[-1]
    assert '"valid": true' in run("predict", "--model", model, "--map", map_path, raw)

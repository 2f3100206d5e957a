"""A bundle in the ORT format runs on the same runtime and gives the same numbers; its page for a hub."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from small_bundle import write_small_bundle
from streams import a_sensor, pass_over, still, stream

import softslide
from softslide.serve.localizer import Localizer

VOLTS = stream(still(0.6), pass_over(1.2), still(0.4))


def offsets(bundle: Path) -> np.ndarray:
    return np.array([estimate.offset_mm for estimate in Localizer.load(bundle).push(VOLTS)])


def export(bundle: Path, shape: str, out: Path) -> int:
    return softslide.main(["export", "--model", str(bundle), "--to", shape, "--out", str(out)])


def test_ort_gives_the_same_numbers(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor(), offset_mm_per_v=50.0)
    assert export(bundle, "ort", tmp_path / "out") == 0
    found = json.loads(capsys.readouterr().out)
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "model.json",
        "model.ort",
        "required_operators.config",
    ]
    assert any("Gemm" in line for line in found["operators"])
    assert offsets(tmp_path / "out") == pytest.approx(offsets(bundle), abs=1e-5, nan_ok=True)


def test_the_page_for_a_hub_reads_and_its_code_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bundle = write_small_bundle(tmp_path / "b", a_sensor(), offset_mm_per_v=50.0)
    assert export(bundle, "hub", tmp_path / "out") == 0
    _, head, body = (tmp_path / "out" / "README.md").read_text().split("---\n", 2)
    assert yaml.safe_load(head)["library_name"] == "softslide"
    assert "accelerometer at (" in body
    monkeypatch.chdir(tmp_path / "out")
    printed: list[tuple] = []
    code = body.split("```python\n")[1].split("```")[0]
    exec(code, {"volts": VOLTS, "print": lambda *values: printed.append(values)})
    assert len(printed) == len(VOLTS) // 20
    assert any(valid for valid, *_ in printed)

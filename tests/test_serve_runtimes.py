"""Runtimes that others wrote work a bundle's example: the table in docs/format.md."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from softslide.models.export.bundle import BEFORE_LAST_STEP, MISFIT_PARITY, PARITY

BUNDLE = Path(__file__).parents[1] / "docs" / "examples" / "bundle"
WORLDS = Path(__file__).parent / "worlds"
CARD = json.loads((BUNDLE / "model.json").read_text(encoding="utf-8"))


def assert_golden(row: list[float]) -> None:
    """As near as a bundle's graph is to the network that it is of."""
    for name, found, golden in zip(CARD["outputs"], row, CARD["golden"]["estimate"], strict=True):
        limit = MISFIT_PARITY if name in BEFORE_LAST_STEP else PARITY
        assert found == pytest.approx(golden, rel=limit, abs=limit), name


@pytest.mark.long
def test_openvino_and_tract_give_the_same_numbers(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True, timeout=300)
    python = tmp_path / "env" / "bin" / "python"
    install = [python, "-m", "pip", "install", "--quiet", "numpy", "openvino", "tract"]
    subprocess.run(install, check=True, timeout=900)
    call = [python, WORLDS / "run_bundle.py", BUNDLE]
    rows = json.loads(subprocess.run(call, check=True, capture_output=True, timeout=120).stdout)
    for name in ("openvino", "tract"):
        assert_golden(rows[name])


@pytest.mark.long
def test_a_browser_s_runtime_gives_the_same_numbers(tmp_path: Path) -> None:
    if not (npm := shutil.which("npm")):
        pytest.skip("npm is absent; install Node.js")
    options = ["--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
    subprocess.run([npm, "install", *options, "onnxruntime-web@1.24"], cwd=tmp_path, check=True, timeout=300)
    shutil.copy(WORLDS / "run_bundle.js", tmp_path)
    call = ["node", "run_bundle.js", BUNDLE, "onnxruntime-web"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, check=True, timeout=120)
    assert_golden(list(json.loads(done.stdout)["estimate"].values()))

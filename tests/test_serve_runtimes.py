"""Other languages and runtimes run a bundle and get the same numbers: the table in docs/format.md."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from bump_map import bump_map
from network_bundle import write_network_bundle
from streams import a_sensor

from softslide.models.export.bundle import BEFORE_LAST_STEP, MISFIT_PARITY, PARITY

BUNDLE = Path(__file__).parents[1] / "docs" / "examples" / "bundle"
WORLDS = Path(__file__).parent / "worlds"
CARD = json.loads((BUNDLE / "model.json").read_text(encoding="utf-8"))
Run = Callable[..., dict[str, dict[str, float]]]


@pytest.fixture
def javascript(request: pytest.FixtureRequest) -> Run:
    """Runs a bundle in a package of Node.js, which is fetched once and kept with pytest's cache."""
    if not (npm := shutil.which("npm")):
        pytest.skip("npm is absent; install Node.js to run bundles from JavaScript")

    def run(package: str, *words: object) -> dict[str, dict[str, float]]:
        assert request.config.cache is not None
        folder = request.config.cache.mkdir(package)
        if not (folder / "done").is_file():
            # Its install script fetches GPU libraries, which nothing here runs.
            options = ["--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
            subprocess.run([npm, "install", "--prefix", folder, *options, package], check=True, timeout=300)
            (folder / "done").touch()
        shutil.copy(WORLDS / "run_bundle.js", folder)
        call = ["node", "run_bundle.js", *map(str, words)]
        done = subprocess.run(call, cwd=folder, capture_output=True, check=True, timeout=120)
        return json.loads(done.stdout)

    return run


def test_javascript_gets_the_same_numbers(javascript: Run, two_boards: Path, tmp_path: Path) -> None:
    """Of one matrix product, and of the default model's graph, not trained."""
    for bundle in (two_boards, write_network_bundle(tmp_path / "bundle", bump_map(), a_sensor())):
        shown = javascript("onnxruntime-node@1.30.0", bundle)
        assert shown["estimate"] == pytest.approx(shown["golden"], rel=1e-5, abs=1e-5)


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
def test_a_browser_s_runtime_gives_the_same_numbers(javascript: Run) -> None:
    shown = javascript("onnxruntime-web@1.24", BUNDLE, "onnxruntime-web")
    assert_golden(list(shown["estimate"].values()))

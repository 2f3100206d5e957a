"""The card suffices: another language runs a bundle and gets the same numbers."""

import json
import shutil
import subprocess
from pathlib import Path

import pytest
from small_bundle import write_small_bundle
from streams import a_sensor

PACKAGE = "onnxruntime-node@1.30.0"


@pytest.fixture(scope="module")
def packages(request: pytest.FixtureRequest) -> Path:
    """A folder with onnxruntime-node, fetched once and kept with pytest's cache."""
    if not (npm := shutil.which("npm")):
        pytest.skip("npm is absent; install Node.js to run bundles from JavaScript")
    assert request.config.cache is not None
    folder = request.config.cache.mkdir(PACKAGE)
    if not (folder / "done").is_file():
        # Its install script fetches GPU libraries, which nothing here runs.
        options = ["--ignore-scripts", "--no-audit", "--no-fund", "--silent"]
        subprocess.run([npm, "install", "--prefix", str(folder), *options, PACKAGE], check=True, timeout=300)
        (folder / "done").touch()
    return folder


def test_javascript_gets_the_same_numbers(packages: Path, tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", a_sensor(2), offset_mm_per_v=50.0)
    shutil.copy(Path(__file__).with_name("run_bundle.js"), packages)
    done = subprocess.run(
        ["node", "run_bundle.js", str(bundle)], cwd=packages, capture_output=True, check=True, timeout=60
    )
    told = json.loads(done.stdout)
    assert told["estimate"] == pytest.approx(told["golden"], rel=1e-5, abs=1e-5)

"""The card suffices: another language runs a bundle and gets the same numbers."""

import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from bump_map import bump_map
from small_bundle import resigned, write_small_bundle
from streams import a_sensor

from softslide.features.card import read_card, write_card
from softslide.models.cnn.gauss_newton import Refinement
from softslide.models.cnn.network import NetworkConfig, Proposal, SlideNetwork
from softslide.models.graph.from_torch import export_graph

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


def network_bundle(folder: Path) -> Path:
    """The default model's graph, not trained, with an example worked out by ONNX Runtime."""
    torch.manual_seed(0)
    config = NetworkConfig()
    network = SlideNetwork(Proposal(2, 1, config), Refinement(bump_map(), 0.02, config.refinement)).eval()
    bundle = write_small_bundle(folder, a_sensor())
    (bundle / "model.onnx").write_bytes(export_graph(network, 1).SerializeToString())
    card = read_card(bundle / "model.json")
    write_card(replace(card, outputs=network.outputs), bundle / "model.json")
    resigned(bundle)
    return bundle


def small_bundle(folder: Path) -> Path:
    return write_small_bundle(folder, a_sensor(2), offset_mm_per_v=50.0)


@pytest.mark.parametrize("write", [small_bundle, network_bundle])
def test_javascript_gets_the_same_numbers(
    packages: Path, tmp_path: Path, write: Callable[[Path], Path]
) -> None:
    bundle = write(tmp_path / "bundle")
    shutil.copy(Path(__file__).parent / "worlds" / "run_bundle.js", packages)
    done = subprocess.run(
        ["node", "run_bundle.js", str(bundle)], cwd=packages, capture_output=True, check=True, timeout=60
    )
    shown = json.loads(done.stdout)
    assert shown["estimate"] == pytest.approx(shown["golden"], rel=1e-5, abs=1e-5)

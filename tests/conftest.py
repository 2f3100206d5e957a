"""What holds for every test: runs are logged into a store, and files cached in a folder, of the test session's own."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from playwright.sync_api import Browser, sync_playwright
from small_bundle import write_small_bundle
from streams import a_sensor

from softslide.serve.localizer import Localizer

CHROMIUM = shutil.which("chromium")
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
)

# No property is one of speed: on a busy machine a single example may take any time.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


@pytest.fixture(scope="session", autouse=True)
def tracking_store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Its address; made when a test first logs a run."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path_factory.mktemp('runs') / 'mlflow.db'}")
        patch.setenv("MLFLOW_DISABLE_TELEMETRY", "true")
        yield os.environ["MLFLOW_TRACKING_URI"]


@pytest.fixture(scope="session", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Solved atlases and calibrated maps of the user are neither read nor written."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOFTSLIDE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one accelerometer. Its offset depends on the window's volts, so that a wrong window shows."""
    return write_small_bundle(tmp_path_factory.mktemp("one") / "b", a_sensor(), offset_mm_per_v=50.0)


@pytest.fixture
def mine(bundle: Path, tmp_path: Path) -> Path:
    """A copy to alter."""
    return Path(shutil.copytree(bundle, tmp_path / "mine"))


@pytest.fixture(scope="session")
def two_boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of two."""
    return write_small_bundle(tmp_path_factory.mktemp("two") / "b", a_sensor(2), offset_mm_per_v=50.0)


@pytest.fixture(scope="session")
def localizer(bundle: Path) -> Localizer:
    """To be reset before use."""
    return Localizer.load(bundle)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no chromium here; install Debian's package 'chromium'")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        yield started
        started.close()

"""What holds for every test: runs are logged into a store, and files cached in a folder, of the test session's own."""

import os
from collections.abc import Iterator

import pytest


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

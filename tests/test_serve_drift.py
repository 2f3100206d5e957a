"""A trained bundle on drifted sensors: errors of at most twice the clean ones."""

from pathlib import Path

import pytest

from softslide.experiments.studies.sensor_drift import drift
from softslide.models.cnn.fit import CnnConfig, fit_cnn
from softslide.models.cnn.training import TrainingConfig
from softslide.models.export.bundle import write_bundle
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.recordings.windows import labelled_windows

BENCH = Path(__file__).parents[1].parent / "shared" / "recordings" / "bench-a"


@pytest.mark.long
@pytest.mark.skipif(
    not BENCH.is_dir(), reason="the bench recordings lie next to the project's folder only at times"
)
def test_drift_at_most_doubles_the_errors(tmp_path: Path) -> None:
    folder = read_folder(BENCH)
    learning = folder.select("calibration")
    config = CnnConfig(training=TrainingConfig(steps=1500, batch=192))
    fitted = fit_cnn(learning, config)
    windows = labelled_windows(learning, fitted.conditioning)
    write_bundle(fitted, folder.sensor, windows, {}, tmp_path / "bundle")
    figures = dict(drift(tmp_path / "bundle", folder.select("test")))
    clean = figures.pop("clean")
    assert clean["valid"] > 0.95
    for label, drifted in figures.items():
        assert drifted["valid"] > 0.95, label
        for error in ("direction_deg", "speed_percent", "offset_mm"):
            assert drifted[error] <= 2 * clean[error], (label, error)

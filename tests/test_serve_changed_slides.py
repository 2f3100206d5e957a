"""A trained bundle on slides whose signal has changed: it abstains, or its intervals hold and errors stay small."""

from pathlib import Path

import pytest

from softslide.experiments.studies.changed_slides import LATE, changed_slides
from softslide.models.cnn.fit import CnnConfig, fit_cnn
from softslide.models.export.bundle import write_bundle
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.recordings.windows import labelled_windows

BENCH = Path(__file__).parents[1].parent / "shared" / "recordings" / "bench-a"
# Valid by chance or not noticed, and how often at most, % (experiments/LOG.md, 2026-11-27): a mirror image; a tenth of
# the supply's usual change; half the amplitude, which another line's is to the noise (43 and 62 % with two trainings).
UNNOTICED = {"V_y mirrored": 100, "supply x 0.99 midway": 30, "supply x 0.95 midway": 20, LATE: 30}
UNNOTICED |= {"amplitude x 0.5": 75}


@pytest.mark.long
@pytest.mark.skipif(
    not BENCH.is_dir(), reason="the bench recordings lie next to the project's folder only at times"
)
def test_it_abstains_or_its_intervals_hold(tmp_path: Path) -> None:
    folder = read_folder(BENCH)
    learning = folder.select("calibration")
    fitted = fit_cnn(learning, CnnConfig())
    windows = labelled_windows(learning, fitted.conditioning)
    write_bundle(fitted, folder.sensor, windows, {}, tmp_path / "bundle")
    found = dict(changed_slides(tmp_path / "bundle", folder, every=4, jobs=2))
    for name, figures in found.items():
        if name in UNNOTICED:
            assert figures["valid"] <= UNNOTICED[name], name
        elif figures["valid"] > 5.0:
            assert min(figures[f"{of}_holds"] for of in ("direction", "speed", "offset")) >= 85.0, name
    for name in ("zero + 50 mV", "mounted at 3 deg", "5 % lost, nan"):
        assert found[name]["valid"] > 75.0, name
        for error in ("direction_deg", "speed_percent", "offset_mm"):
            assert found[name][error] <= 2 * found["none"][error], (name, error)

"""The registry: names without heavy imports, and a model added as CONTRIBUTING.md says, in one file and one line."""

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from softslide.features.errors import InputError
from softslide.models import registry
from softslide.models.export.bundle import write_bundle
from softslide.models.fitted_model import Given
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.windows import labelled_windows
from softslide.serve.predict import predict

ROOT = Path(__file__).parents[1]
LINE = re.compile(r'^    "(\w+)": "([\w.]+)",$', re.MULTILINE)


def code_blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(), re.DOTALL)


@pytest.fixture
def added(monkeypatch):
    """The model shown in CONTRIBUTING.md, registered by the line shown there."""
    source, line = code_blocks()
    found = LINE.search(line)
    assert found is not None
    name, path = found.groups()
    module = ModuleType(path)
    monkeypatch.setitem(sys.modules, path, module)
    exec(compile(source, path, "exec"), module.__dict__)
    monkeypatch.setitem(registry.MODELS, name, path)
    return name


def test_the_model_of_the_guide_is_fitted_exported_and_predicts(added, tmp_path):
    folder = read_folder(SAMPLE).select("calibration").labelled()
    model = registry.model_named(added)
    fitted = registry.fit_model(model, folder, model.config())
    windows = labelled_windows(folder, fitted.conditioning)
    write_bundle(fitted, folder.sensor, windows, {}, tmp_path / "bundle")
    # On lines it has not seen it does far better than chance: 90 degrees, and the lines' own offsets.
    spread = folder.manifest["offset_mm"].abs().mean()
    assert fitted.summary["heldout_direction_deg"] < 20.0
    assert fitted.summary["heldout_offset_mm"] < 0.6 * spread
    rows = folder.manifest.iloc[::20]
    lines = list(predict(tmp_path / "bundle", [folder.root / row.file for row in rows.itertuples()]))
    assert [line["recording"] for line in lines] == list(rows.index)
    errors = [line["offset_mm"] - row.offset_mm for line, row in zip(lines, rows.itertuples(), strict=True)]
    assert np.abs(errors).mean() < 0.5 * spread


def test_the_guide_s_model_is_short():
    """Without imports, blank lines and decorators."""
    body = code_blocks()[0].split("import Regressor, regression_table")[1]
    lines = [line for line in body.splitlines() if line.strip() and not line.startswith("@")]
    assert len(lines) <= 20


def test_the_registry_lines_of_the_guide_are_of_the_registry_s_form():
    source = Path(registry.__file__).read_text()
    assert dict(LINE.findall(source)) == registry.MODELS


def test_an_unknown_name_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="name one of interpolation, trees, mlp, gp, cnn"):
        registry.model_named("oracle")


@pytest.mark.parametrize("name", ["interpolation", "trees", "mlp", "gp"])
def test_a_model_on_features_refuses_a_bundle_to_start_from(name):
    folder, model = read_folder(SAMPLE).select("calibration"), registry.model_named(name)
    with pytest.raises(InputError, match="starts from no bundle"):
        registry.fit_model(model, folder, model.config(), Given(init=object()))

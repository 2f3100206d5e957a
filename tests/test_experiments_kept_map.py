"""The calibrated map that is kept: a second training takes it, to the same bytes, and notices what has changed."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from softslide.experiments import kept_map as module
from softslide.experiments.kept_map import kept_map
from softslide.experiments.train import train
from softslide.features.errors import InputError
from softslide.models.registry import model_named
from softslide.models.response_map import select
from softslide.models.response_map.select import CalibratedMap
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder, write_folder
from softslide.pipeline.recordings.heights import HEIGHT

CONFIG = """
calibration.iterations = 1
network.refinement.steps = 2
[training]
steps = 200
batch = 32
average = 0.9
"""
# From recordings alone, two candidates: the quickest calibration there is.
COUNT = 26


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """The sample's fastest calibration slides."""
    folder = read_folder(SAMPLE).select("calibration")
    names = folder.manifest["speed_mm_s"].nlargest(COUNT).index
    recordings = [folder.load(str(name)) for name in names]
    place = tmp_path_factory.mktemp("kept") / "lab"
    return write_folder(place, folder.sensor, folder.manifest.loc[names], recordings)


@pytest.fixture(scope="module")
def kept(lab: Folder, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CalibratedMap]:
    """A cache with the lab's map, and the map."""
    place = tmp_path_factory.mktemp("kept") / "cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOFTSLIDE_CACHE", str(place))
        made, taken = found(lab)
    assert not taken
    return place, made


@pytest.fixture
def cache(kept: tuple[Path, CalibratedMap], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of that cache; the folder of its maps."""
    shutil.copytree(kept[0], tmp_path / "cache")
    monkeypatch.setenv("SOFTSLIDE_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "maps"


class Made(Exception):
    """A map is calibrated."""


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    """A calibration ends as it begins, with Made."""

    def calibrated(*given: object) -> None:
        raise Made

    monkeypatch.setattr(module, "calibrated_map", calibrated)


def found(
    folder: Folder, config: CalibrationConfig | None = None, **options: bool
) -> tuple[CalibratedMap, bool]:
    """The map, and whether it was taken from what was kept."""
    cnn, taken = model_named("cnn").config(), []
    conditioning = replace(cnn.conditioning, delayed=0.1)
    calibration = config or replace(cnn.calibration, iterations=1)
    found = kept_map(folder, None, conditioning, calibration, cnn.spread, taken=taken.append, **options)
    return found, bool(taken)


def assert_same(a: CalibratedMap, b: CalibratedMap) -> None:
    for x, y in zip(
        [a.response, *(m for m, _ in a.held_out)], [b.response, *(m for m, _ in b.held_out)], strict=True
    ):
        for name, value in vars(x).items():
            np.testing.assert_array_equal(value, getattr(y, name), name)
            assert type(value) is type(getattr(y, name)), name
    for (_, x), (_, y) in zip(a.held_out, b.held_out, strict=True):
        np.testing.assert_array_equal(x, y)
    assert (a.conditioning, a.slides, a.summary) == (b.conditioning, b.slides, b.summary)
    assert (a.untimed, a.left_out) == (b.untimed, b.left_out)
    assert a.heights == b.heights
    assert a.folder.manifest.equals(b.folder.manifest)


@pytest.mark.parametrize(("over", "apart"), [(0.0105, False), (0.012, True)])
def test_a_map_over_heights_is_kept_too(
    lab: Folder, cache: Path, monkeypatch: pytest.MonkeyPatch, over: float, apart: bool
) -> None:
    """apart: a map of the main height is clearly better, and the others' recordings are left out."""
    shares = {"map_over_heights": over, "map_a_height": 0.01}
    monkeypatch.setattr(select, "_shares_at_other_heights", lambda *given: shares)
    again = lab.manifest.iloc[:4].rename(index="{}-higher".format)
    table = pd.concat([lab.manifest, again])
    table[HEIGHT] = np.where(np.arange(len(table)) < COUNT, 7.0, 8.0)
    folder = replace(lab, manifest=table)
    first, second = found(folder), found(folder)
    assert second[1]
    assert_same(first[0], second[0])
    assert (first[0].heights is None) is apart
    assert len(first[0].folder) == first[0].slides == first[0].summary["slides"] == len(table) - 4 * apart
    assert len(first[0].left_out) == 4 * apart
    assert all("map of each height" in why for why in first[0].left_out.values())


def test_a_second_call_takes_what_the_first_kept(
    lab: Folder, kept: tuple[Path, CalibratedMap], cache: Path, watched: None
) -> None:
    again, taken = found(lab)
    assert taken
    assert_same(kept[1], again)
    assert len(list(cache.iterdir())) == 1
    with pytest.raises(Made):
        found(lab, fresh=True)


def test_other_data_settings_and_code_are_noticed(
    lab: Folder, cache: Path, watched: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What of recordings counts is tested with their hashes (test_experiments_tracking.py)."""
    table = lab.manifest.copy()
    table.loc[table.index[0], "depth_mm"] += 0.01
    with pytest.raises(Made):
        found(replace(lab, manifest=table))
    with pytest.raises(Made):
        found(replace(lab, sensor=replace(lab.sensor, pressure_mpa=0.03)))
    with pytest.raises(Made):
        found(lab, CalibrationConfig(iterations=1, gain_sd=0.02))
    monkeypatch.setattr(module, "MAKER", "softslide.models.registry")
    with pytest.raises(Made):
        found(lab)


@pytest.fixture
def at_once(kept: tuple[Path, CalibratedMap], monkeypatch: pytest.MonkeyPatch) -> None:
    """Every calibration ends at once, with that map."""
    monkeypatch.setattr(module, "calibrated_map", lambda *given: kept[1])


def test_a_damaged_file_is_made_anew(
    lab: Folder, kept: tuple[Path, CalibratedMap], cache: Path, at_once: None
) -> None:
    (file,) = cache.iterdir()
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 2] ^= 1
    for damaged in (bytes(whole), b"", b"no map"):
        file.write_bytes(damaged)
        assert not found(lab)[1]
        again, taken = found(lab)
        assert taken
        assert_same(kept[1], again)


def test_a_cache_that_cannot_be_written_costs_nothing(
    lab: Folder, at_once: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SOFTSLIDE_CACHE", str(tmp_path / "file"))
    assert not found(lab)[1]


def test_the_oldest_go(lab: Folder, cache: Path, at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 2)
    (oldest,) = cache.iterdir()
    for gain_sd in (0.02, 0.04):
        found(lab, CalibrationConfig(iterations=1, gain_sd=gain_sd))
    assert len(list(cache.iterdir())) == 2
    assert not oldest.exists()


def test_an_error_keeps_nothing(lab: Folder, cache: Path) -> None:
    few, before = replace(lab, manifest=lab.manifest.iloc[:3]), set(cache.iterdir())
    with pytest.raises(InputError):
        found(few)
    assert set(cache.iterdir()) == before


@pytest.mark.long
def test_the_bundle_is_the_same_to_the_byte(
    lab: Folder, cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Calibrated anew, then with what was kept."""
    (tmp_path / "config.toml").write_text(CONFIG)
    bundles, said = [], []
    for fresh in (True, False):
        out = tmp_path / f"bundle-{fresh}"
        train(lab.root, out, config=tmp_path / "config.toml", fresh=fresh, track=False)
        bundles.append({path.name: path.read_bytes() for path in out.iterdir()})
        said.append("took the response map that an earlier training kept" in capsys.readouterr().err)
    assert said == [False, True]
    assert bundles[0] == bundles[1]

"""Several folders of one sensor, read as one; and the pressure that a model is for."""

from dataclasses import replace

import numpy as np
import pytest
from bump_slides import bump_folder, bump_sensor, lines

from softslide.features.errors import InputError
from softslide.pipeline.recordings.derived_labels import (
    recordings_to_learn_from,
    why_not_labelled,
    with_derived_labels,
)
from softslide.pipeline.recordings.folder import Folder, write_folder
from softslide.pipeline.recordings.pooled import WEIGHT, read_folders


def renamed(folder: Folder, root, letter: str, sensor=None, **columns) -> Folder:
    """The folder's recordings in another, their names beginning with the letter."""
    names = [f"{letter}{name}" for name in folder.manifest.index]
    recordings = [
        replace(folder.load(old), name=new) for old, new in zip(folder.manifest.index, names, strict=True)
    ]
    table = folder.manifest.set_axis(names).rename_axis("recording").assign(**columns)
    return write_folder(root, sensor or folder.sensor, table, recordings)


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    root = tmp_path_factory.mktemp("pooled")
    first = bump_folder(root / "a", bump_sensor(1), {"calibration": lines([0.0], [0.0, 4.0], [6.0])})
    return first, renamed(first, root / "b" / "deep", "d", depth_mm=0.9)


def test_pooled_folders_hold_the_recordings_of_each(two):
    both = read_folders([folder.root for folder in two])
    assert list(both.manifest.index) == [name for folder in two for name in folder.manifest.index]
    assert list(both.manifest["depth_mm"]) == [0.5, 0.5, 0.9, 0.9]
    for folder in two:
        for name in folder.manifest.index:
            assert np.array_equal(both.load(name).volts, folder.load(name).volts)


def test_folders_of_other_sensors_or_with_a_name_twice_are_refused(two, tmp_path):
    first, _ = two
    with pytest.raises(InputError, match=f"{first.manifest.index[0]}.*several of the folders"):
        read_folders([first.root, first.root])
    moved = replace(first.sensor.accelerometers[0], x_mm=3.0)
    renamed(first, tmp_path / "c", "c", sensor=replace(first.sensor, accelerometers=(moved,)))
    with pytest.raises(InputError, match="accelerometers is"):
        read_folders([first.root, tmp_path / "c"])


def test_folders_have_weights(two):
    first, second = two
    pooled = read_folders([first.root, second.root], [1.0, 0.25])
    assert list(pooled.manifest[WEIGHT]) == [1.0] * len(first) + [0.25] * len(second)
    assert WEIGHT not in read_folders([first.root, second.root]).manifest
    for wrong in ([1.0], [1.0, 0.0], [1.0, np.inf]):
        with pytest.raises(InputError, match="for 2 folders"):
            read_folders([first.root, second.root], wrong)


def test_a_model_is_for_the_pressure_that_most_recordings_have(two):
    first, _ = two
    table = first.manifest.loc[first.manifest.index.repeat(2)]
    table.index = ["a", "b", "c", "d"]
    folder = replace(first, manifest=table.assign(pressure_mpa=[0.04, 0.04, 0.03, np.nan]))
    kept = recordings_to_learn_from(folder)
    assert list(kept.manifest.index) == ["a", "b", "d"]
    assert kept.sensor.pressure_mpa == 0.04
    why = why_not_labelled(with_derived_labels(folder))
    assert list(why) == ["c"]
    assert "0.03" in why["c"]

"""The error while a plan is recorded: of slides that the map has not seen; enough ends the slides to learn from."""

from dataclasses import replace
from pathlib import Path

import pytest
from sender import PLAN, free_port, sending
from streams import a_sensor

from softslide.experiments.acquisition import error_so_far, verdict
from softslide.experiments.acquisition.error_so_far import ErrorSoFar, errors, read_goal
from softslide.experiments.acquisition.record import record
from softslide.experiments.acquisition.verdict import Verdict
from softslide.features.errors import InputError
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.recordings.folder import SAMPLE, Folder, read_folder
from softslide.pipeline.sensor import write_sensor


@pytest.fixture(scope="module")
def sample() -> Folder:
    return read_folder(SAMPLE)


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two slides, from the fourth on."""
    monkeypatch.setattr(error_so_far, "FIRST", 3)
    for module in (error_so_far, verdict):
        monkeypatch.setattr(module, "NEWEST", 2)


def first(folder: Folder, learned: int, others: int = 0) -> Folder:
    rows = folder.manifest
    calibration = rows["split"] == "calibration"
    names = [*rows.index[~calibration][:others], *rows.index[calibration][:learned]]
    return replace(folder, manifest=rows.loc[names])


def test_each_slide_is_scored_by_the_map_of_those_before(sample: Folder, soon: None) -> None:
    so_far = ErrorSoFar(atlas_of(sample.sensor))
    assert len(so_far.newest(first(sample, 3))) == 0
    newest = so_far.newest(first(sample, 5, others=1))
    names = list(first(sample, 5).manifest.index)
    assert list(newest.index) == names[3:]
    before, this = first(sample, 4), replace(sample, manifest=sample.manifest.loc[[names[4]]])
    expected = errors(before, this, atlas_of(sample.sensor))
    assert newest.loc[names[4]].to_list() == pytest.approx(expected.iloc[0].to_list())
    assert 0.0 < newest["direction_deg"].max() < 20.0


def test_enough_is_a_mean_of_enough_slides(sample: Folder, soon: None, tmp_path: Path) -> None:
    plan = first(sample, 8).manifest.assign(waypoints=None)
    page, said = tmp_path / "page.html", list[str]()
    atlas = atlas_of(sample.sensor)
    loose = Verdict(["90deg", "900%"], page, plan, atlas)
    assert not loose.is_enough(first(sample, 0), said.append)
    assert not loose.is_enough(first(sample, 4), said.append)
    assert "http-equiv" in page.read_text()
    assert loose.is_enough(first(sample, 5), said.append)
    assert "that is enough" in said[-1]
    assert "5 of 8 slides are recorded" in page.read_text()
    spoken = len(said)
    assert loose.is_enough(first(sample, 5, others=1), said.append)
    assert len(said) == spoken
    assert not Verdict(["90deg", "0.001mm"], None, plan, atlas).is_enough(first(sample, 5), said.append)
    assert not Verdict([], page, plan, atlas).is_enough(first(sample, 5), said.append)


def test_slides_that_go_another_way_are_said(sample: Folder, soon: None) -> None:
    """As of an axis that stalls or a wire in the wrong place: the labels of two slides are another's."""
    folder, said = first(sample, 6), list[str]()
    names = list(folder.manifest.index)
    turned = folder.manifest.copy()
    turned.loc[names[4:], "direction_deg"] = (turned.loc[names[4:], "direction_deg"] + 90.0) % 360.0
    turned.loc[names[4:], ["offset_mm", "motion_start_s", "motion_end_s"]] = float("nan")
    assert not Verdict(["1mm"], None, turned, atlas_of(sample.sensor)).is_enough(
        replace(folder, manifest=turned), said.append
    )
    assert "2 of them go another way than planned" in said[-1]


@pytest.mark.parametrize("word", ["0.3", "deg", "-1deg", "0mm", "1.2.3%", "nandeg", "0.3 deg"])
def test_a_goal_without_number_or_unit_is_refused(word: str) -> None:
    with pytest.raises(InputError, match="give an error to reach"):
        read_goal(["0.7%", word])


def test_what_is_enough_leaves_the_slides_to_learn_from_and_goes_on_with_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_sensor(tmp_path / "sensor.toml", a_sensor())
    rows = ("one,calibration,0", "two,calibration,90", "three,test,0", "four,calibration,0")
    (tmp_path / "plan.csv").write_text(PLAN + "".join(f"{row},40,-5,-29,-5,8,0.5\n" for row in rows))
    monkeypatch.setattr(Verdict, "is_enough", lambda self, folder, say: len(folder) > 0)
    monkeypatch.setattr(error_so_far, "atlas_to_calibrate", lambda sensor: None)  # a solver's minutes
    port = free_port()
    with sending(port):
        times = {"rest_s": 0.6, "start_s": 0.2}
        options = {"sensor": tmp_path / "sensor.toml", "yes": True, "until": ["1deg"], **times}
        folder, left = record(f"udp://:{port}", tmp_path / "plan.csv", tmp_path / "out", **options)
    assert list(folder.manifest.index) == ["one", "three"]
    assert left == 2

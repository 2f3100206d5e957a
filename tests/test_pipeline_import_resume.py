"""An interrupted import goes on where it was, and loses nothing."""

from dataclasses import replace
from pathlib import Path

import pytest
from imported_lab import imported
from lab_files import FORMATS, slide, write_lab
from long_commands import contents

from softslide.pipeline.importers import run
from softslide.pipeline.importers.import_map import read_map
from softslide.pipeline.importers.resume import Journal
from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.importers.sources import find_sources
from softslide.pipeline.recordings.folder import read_folder


def interrupt_at(name: str, map_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An import that is interrupted as it calls this function."""

    def interrupted(*rest, **more):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(f"softslide.pipeline.importers.run.{name}", interrupted)
        with pytest.raises(KeyboardInterrupt):
            imported(map_path, map_path.with_name("out"))


def test_an_interrupted_import_resumes(tmp_path: Path, monkeypatch) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"], ("one", "two", "three"))
    read, begun = run.write_even, []

    def interrupted(source, *rest):
        begun.append(source.name)
        if len(begun) == 3:
            raise KeyboardInterrupt
        return read(source, *rest)

    monkeypatch.setattr(run, "write_even", interrupted)
    with pytest.raises(KeyboardInterrupt):
        imported(map_path, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(run, "write_even", read)
    done = import_recordings([tmp_path / "lab"], map_path, tmp_path / "out")
    assert done.resumed == 2
    imported(map_path, tmp_path / "afresh")
    assert contents(tmp_path / "out") == contents(tmp_path / "afresh")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["afresh", "lab", "map.toml", "out", "sensor.toml"]


@pytest.mark.parametrize("last", ["write_manifest", "shutil.rmtree"])
def test_an_import_interrupted_as_it_ends_loses_nothing(tmp_path: Path, monkeypatch, last: str) -> None:
    """Before its folder is there, or after; slides that are read anew do not reach into a folder that is whole."""
    map_path = write_lab(tmp_path, FORMATS["csv"])
    interrupt_at(last, map_path, monkeypatch)
    assert (tmp_path / "out").exists() is (last == "shutil.rmtree")
    assert import_recordings([tmp_path / "lab"], map_path, tmp_path / "out").resumed == 2
    interrupt_at("shutil.rmtree", map_path, monkeypatch)
    before = contents(tmp_path / "out")
    FORMATS["csv"].write(tmp_path / "lab", "one", *slide(7, 300))
    interrupt_at("_finish", map_path, monkeypatch)
    assert contents(tmp_path / "out") == before


@pytest.mark.parametrize(
    "left", [{}, {"one.parquet": b"PAR1"}, {"one.parquet": b"PAR1", "one.json": b'{"map"'}]
)
def test_what_a_killed_import_leaves_does_not_stop_the_next(tmp_path: Path, left: dict[str, bytes]) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    imported(map_path, tmp_path / "out")
    before = contents(tmp_path / "out")
    (tmp_path / ".out.partial" / "raw").mkdir(parents=True)
    for name, content in left.items():
        (tmp_path / ".out.partial" / "raw" / name).write_bytes(content)
    imported(map_path, tmp_path / "out")
    assert contents(tmp_path / "out") == before
    assert not (tmp_path / ".out.partial").exists()


@pytest.mark.parametrize("change", ["map", "source"])
def test_what_another_map_or_source_made_is_done_again(tmp_path: Path, monkeypatch, change) -> None:
    map_path = write_lab(tmp_path, FORMATS["csv"])
    interrupt_at("_finish", map_path, monkeypatch)
    if change == "map":
        map_path.write_text(map_path.read_text() + '[labels.split]\nvalue = "test"\n')
    else:
        FORMATS["csv"].write(tmp_path / "lab", "one", *slide(7, 300))
    done = import_recordings([tmp_path / "lab"], map_path, tmp_path / "out")
    assert done.resumed == (0 if change == "map" else 1)
    folder = read_folder(tmp_path / "out")
    assert len(folder.load("one").time_s) == (250 if change == "map" else 300)


def test_a_note_of_another_map_is_gone_before_the_slide_is_written_anew(tmp_path: Path) -> None:
    mapping = read_map(write_lab(tmp_path, FORMATS["csv"]))
    (job, _), journal = find_sources([tmp_path / "lab"], mapping), Journal(tmp_path / "work", mapping)
    journal.add(job, {})
    journal.slide(job.name).touch()
    assert journal.find(job) is not None
    assert Journal(tmp_path / "work", replace(mapping, signs="zones")).find(job) is None
    assert journal.find(job) is None

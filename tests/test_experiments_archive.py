"""Evaluation of many recordings: it goes on where it was stopped, and a Dask cluster gives the same bytes."""

import math
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest
from front_door import call
from small_bundle import write_small_bundle
from team_server import PATIENCE_S, free_port
from trial_folder import SENSOR, a_folder

from softslide.experiments.evaluation.archive import CHUNK, Archive
from softslide.experiments.evaluation.readout import open_localizer, predictions
from softslide.pipeline.recordings.folder import read_folder

HERE = Path(__file__).parents[1]
RECORDINGS = 2 * CHUNK + 1


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_bundle(tmp_path_factory.mktemp("archive") / "bundle", SENSOR, offset_mm_per_v=50.0)


def evaluate(bundle: Path, lab: Path, out: Path, *options: object) -> int:
    words = ("--model", bundle, "--recordings", lab, "--out", out, "--jobs", 1, "--no-report")
    return call("evaluate", *words, *options)


def test_a_bundle_that_was_trained_anew_at_its_place_is_the_one_that_is_read(tmp_path: Path) -> None:
    for direction_deg in (30.0, 70.0):
        shutil.rmtree(tmp_path / "bundle", ignore_errors=True)
        made = write_small_bundle(tmp_path / "bundle", SENSOR, direction_deg=direction_deg)
        cosine = open_localizer(made).card.golden["estimate"][0]
        assert cosine == pytest.approx(math.cos(math.radians(direction_deg)))


def test_it_goes_on_where_it_was_stopped(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A broken recording among the last: when it is mended, what was done is not done again."""
    lab = a_folder(tmp_path / "lab", **{f"r{n}": {} for n in range(RECORDINGS)}).root
    assert evaluate(bundle, lab, tmp_path / "whole") == 1  # no bound is tested
    last = lab / "slides" / f"r{RECORDINGS - 1}.parquet"
    content = last.read_bytes()
    last.write_bytes(b"not a recording")
    assert evaluate(bundle, lab, tmp_path / "out") == 2
    work = tmp_path / ".out.work"
    done = {path: path.stat().st_mtime_ns for path in work.iterdir()}
    assert len(done) == 2
    last.write_bytes(content)
    folder = read_folder(lab)
    seen = list(predictions(bundle, folder, Archive(1, "", work)))
    assert [len(each["recording"].unique()) for each in seen] == [CHUNK, CHUNK, 1]
    assert {path: path.stat().st_mtime_ns for path in work.iterdir()}.items() >= done.items()
    assert evaluate(bundle, lab, tmp_path / "out") == 1
    assert not work.exists()
    for name in ("predictions.csv", "metrics.json"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


def test_what_changed_is_done_again(bundle: Path, tmp_path: Path) -> None:
    """Kept rows are those of the same bundle, labels and files."""
    folder = a_folder(tmp_path / "lab", one={}, two={})
    (work := tmp_path / "work").mkdir()

    def count() -> int:
        """How many chunks are kept after another call."""
        list(predictions(bundle, read_folder(folder.root), Archive(1, "", work)))
        return len(list(work.iterdir()))

    assert (count(), count()) == (1, 1)
    slide = folder.root / "slides" / "one.parquet"
    os.utime(slide, ns=(0, slide.stat().st_mtime_ns + 1))
    assert count() == 2
    other = write_small_bundle(tmp_path / "other", SENSOR, direction_deg=31.0)
    list(predictions(other, folder, Archive(1, "", work)))
    assert len(list(work.iterdir())) == 3


def test_each_uncommitted_edit_has_chunks_of_its_own(
    bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But not one of a comment."""
    code = tmp_path / "code"
    (code / "experiments").mkdir(parents=True)
    monkeypatch.setattr("softslide.experiments.code_hash.ROOT", code)
    folder, work = a_folder(tmp_path / "lab", one={}), tmp_path / "work"
    work.mkdir()

    def make(*_: object) -> pd.DataFrame:
        return pd.DataFrame({"a": [1]})

    make.__module__ = "softslide.experiments.reader"

    def count(source: str) -> int:
        """How many chunks are kept after a call with this code."""
        (code / "experiments" / "reader.py").write_text(source)
        list(Archive(1, "", work).tables("a", make, bundle, folder))
        return len(list(work.iterdir()))

    sources = ("gain = 1\n", "gain = 2\n", "gain = 3\n", "gain = 3  # of the amplifier\n")
    assert [count(source) for source in sources] == [1, 2, 3, 3]


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A Dask scheduler and two workers, each a process of its own."""
    distributed = pytest.importorskip("distributed")
    place, address = tmp_path_factory.mktemp("dask"), f"tcp://127.0.0.1:{free_port()}"
    environment = {**os.environ, "PYTHONPATH": str(HERE)}
    port = address.rpartition(":")[2]
    quiet = ["--no-dashboard"]
    commands = [["scheduler", "--host", "127.0.0.1", "--port", port, *quiet]]
    commands += 2 * [["worker", address, "--nthreads", "1", "--no-nanny", *quiet]]
    running = []
    with (place / "log").open("wb") as log:
        try:
            for command in commands:
                words = [sys.executable, "-m", "dask", *command]
                running.append(subprocess.Popen(words, cwd=place, env=environment, stdout=log, stderr=log))
            with distributed.Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=PATIENCE_S)
            yield address
        finally:
            for process in running:
                process.kill()
                process.wait(PATIENCE_S)


def test_a_cluster_gives_the_same_bytes(
    scheduler: str, bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named as seen from here, while the workers are elsewhere."""
    import distributed

    monkeypatch.chdir(tmp_path)
    lab = a_folder(tmp_path / "lab", **{f"r{n}": {} for n in range(RECORDINGS)}).root
    evaluate(bundle, lab, tmp_path / "here")
    own = Path(os.path.relpath(bundle, tmp_path))
    assert evaluate(own, Path("lab"), tmp_path / "there", "--scheduler", scheduler) == 1
    for name in ("predictions.csv", "metrics.json"):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()
    with distributed.Client(scheduler, timeout=PATIENCE_S, set_as_default=False) as client:
        done = client.run(lambda dask_worker: dask_worker.state.executed_count)
    assert len(done) == 2
    assert sum(done.values()) >= 3


def test_a_scheduler_that_does_not_answer_is_named(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab, address = a_folder(tmp_path / "lab", one={}).root, f"tcp://127.0.0.1:{free_port()}"
    began = time.monotonic()
    assert evaluate(bundle, lab, tmp_path / "out", "--scheduler", address) == 2
    assert time.monotonic() - began < PATIENCE_S
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith(f"softslide evaluate: --scheduler {address}: no Dask scheduler answers")

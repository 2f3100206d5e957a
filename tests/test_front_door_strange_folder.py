"""A command called in somebody's folder runs nothing that lies there."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from sample_folder import sample_folder

import softslide
from softslide.pipeline.recordings.folder import SAMPLE

ROOT = Path(softslide.__file__).parents[1]
TRAP = "open({!r}, 'a').write(__name__ + '\\n')\nraise SystemExit('a trap')\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder whose modules note that they were imported."""
    ours, theirs = ("features", "pipeline"), ("joblib", "numpy", "uvicorn")
    for name in (*ours, *theirs, "multiprocessing", "json", "socket", "typing", "re"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(TRAP.format(str(tmp_path / "sprung")))
    return tmp_path


def called(folder: Path, *words: str) -> subprocess.Popen:
    outside = {"cwd": folder, "env": os.environ | {"PYTHONPATH": str(ROOT)}}
    return subprocess.Popen(
        [sys.executable, *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **outside,
    )


def printed(folder: Path, *words: str) -> bytes:
    """What it has printed once it has ended well."""
    with called(folder, *words) as running:
        said, wrong = running.communicate(timeout=120)
    assert running.returncode == 0, wrong
    return said


def test_the_module_is_called(folder: Path) -> None:
    few = sample_folder(folder / "few", "split == 'test-fast'")
    assert b"3 recordings, 0 errors" in printed(folder, "-m", "softslide", "check", str(few))
    assert not (folder / "sprung").exists()


def test_a_study_is_called(folder: Path) -> None:
    assert b"usage:" in printed(folder, "-m", "softslide.experiments.bench", "--help")
    assert not (folder / "sprung").exists()


def test_settings_of_libraries_are_not_taken_from_the_folder(tmp_path: Path) -> None:
    """A cache of compiled code is loaded as it is; LaTeX is a program of its own."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: compiled\n")
    show = "import softslide.pipeline.skin.loads, numba; print(repr(numba.config.CACHE_DIR))"
    assert printed(tmp_path, "-P", "-c", show).strip() == b"''"
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n")
    printed(tmp_path, "-m", "softslide", "check", str(SAMPLE), "--picture", "seen.svg")
    assert (tmp_path / "seen.svg").exists()


def test_the_page_has_a_process_of_its_own(folder: Path, bundle: Path) -> None:
    serve = ["-m", "softslide", "serve", "--model", str(bundle), "--source", "-", "--page", "0"]
    with called(folder, *serve) as running:
        lines = [running.stderr.readline() for _ in range(2)]
        running.send_signal(signal.SIGINT)
        running.communicate(timeout=60)
    assert b"the page is at" in lines[1]
    assert not (folder / "sprung").exists()


def test_workers_are_processes_of_their_own(folder: Path) -> None:
    work = "from pipeline.workers import results; print(list(results(pow, [(2, 3), (3, 2)], 2)))"
    assert printed(folder, "-P", "-c", work).strip() == b"[8, 9]"
    assert not (folder / "sprung").exists()

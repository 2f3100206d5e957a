"""An output appears whole or not at all, whenever its process is killed, and whoever else writes it."""

import itertools
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from softslide.features.errors import InputError
from softslide.pipeline.staging import alone, check_replaceable, staged, whole

HERE = Path(__file__).parents[1]
PATIENCE_S = 120
# Writes two files `times` times, and is killed before its `number`th change to the disk.
WRITER = """
import os, signal, sys
from pathlib import Path
from softslide.pipeline.staging import alone, check_replaceable, staged, whole
out, text, times, number = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
changes = 0
def count(event, arguments):
    global changes
    if event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir") or (
        event == "open" and isinstance(arguments[1], str) and "w" in arguments[1]
    ):
        changes += 1
        if changes == number:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(count)
for _ in range(times):
    with staged(out) as scratch:
        (scratch / "one").write_text(text)
        (scratch / "two").write_text(text)
"""


def python(code: str, *before: str, check: bool = False) -> subprocess.CompletedProcess:
    command = [
        *before,
        sys.executable,
        "-c",
        "from pathlib import Path; from pipeline.staging import *\n" + code,
    ]
    return subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=check, timeout=PATIENCE_S)


def writer(out: Path, text: str, times: int = 1, number: int = 0) -> subprocess.Popen:
    command = [sys.executable, "-c", WRITER, str(out), text, str(times), str(number)]
    return subprocess.Popen(command, cwd=HERE, stderr=subprocess.PIPE)


def ended(process: subprocess.Popen) -> int:
    _, error = process.communicate(timeout=PATIENCE_S)
    assert process.returncode in (0, -signal.SIGKILL), error.decode()
    return process.returncode


def content(out: Path) -> set[str]:
    """The texts of its two files."""
    assert sorted(path.name for path in out.iterdir()) == ["one", "two"]
    return {path.read_text() for path in out.iterdir()}


def write_half(out: Path) -> None:
    with staged(out) as scratch:
        (scratch / "one").write_text("half")
        raise InputError("half")


@pytest.mark.parametrize("replaced", [False, True], ids=["new", "replaced"])
def test_killed_at_any_change_to_the_disk(tmp_path: Path, replaced: bool) -> None:
    for number in itertools.count(1):
        out = tmp_path / str(number) / "out"
        if replaced:
            assert ended(writer(out, "before")) == 0
        if ended(writer(out, "killed", number=number)) == 0:
            break
        if out.exists():
            assert content(out) in ([{"before"}, {"killed"}] if replaced else [{"killed"}])
        # The next process fails as it writes: what was there before it is there after it.
        with pytest.raises(InputError):
            write_half(out)
        assert [path.name for path in out.parent.iterdir()] in ([["out"]] if replaced else [["out"], []])
        if replaced:
            assert content(out) in ({"before"}, {"killed"})
        assert ended(writer(out, "after")) == 0
        assert content(out) == {"after"}
        assert [path.name for path in out.parent.iterdir()] == ["out"]
    # Made, written twice, renamed and removed: more when something is replaced.
    assert number > (9 if replaced else 6)


def test_the_folder_of_a_living_process_stays(tmp_path: Path) -> None:
    with staged(tmp_path / "out") as slow:
        (slow / "one").write_text("slow")
        assert ended(writer(tmp_path / "out", "quick")) == 0
        assert (slow / "one").read_text() == "slow"
        (slow / "two").write_text("slow")
    assert content(tmp_path / "out") == {"slow"}


def test_several_processes_replace_one_output(tmp_path: Path) -> None:
    running = [writer(tmp_path / "out", text, times=30) for text in ("a", "b", "c")]
    assert [ended(process) for process in running] == [0, 0, 0]
    assert content(tmp_path / "out") < {"a", "b", "c"}
    assert len(content(tmp_path / "out")) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_looks_like_a_leftover_of_another_output_stays(tmp_path: Path) -> None:
    for name in (".out.settings", ".out.partial", ".other.unfinished-abcdefgh", "out.unfinished-abcdefgh"):
        (tmp_path / name).mkdir()
    with staged(tmp_path / "out") as scratch:
        (scratch / "one").write_text("text")
    assert len(list(tmp_path.iterdir())) == 5


def test_one_process_at_a_time_works_on_an_output(tmp_path: Path) -> None:
    work, out = tmp_path / ".out.work", tmp_path / "out"
    other = f"with alone(Path({str(work)!r}), Path('out')): pass"
    with alone(work, out):
        (work / "done").write_text("")
        assert "InputError: out: another call is at work on it" in python(other).stderr
    assert (work / "done").exists()
    (work / "done").unlink()
    python(other, check=True)
    assert not work.exists()


def test_a_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    def half() -> None:
        with whole(tmp_path / "a.txt") as scratch:
            scratch.write_text("half")
            raise InputError("half")

    with pytest.raises(InputError):
        half()
    assert list(tmp_path.iterdir()) == []
    with whole(tmp_path / "a.txt") as scratch:
        scratch.write_text("whole")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.txt", "whole")]


def test_a_place_that_cannot_be_written_is_found_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written; name another folder"):
        check_replaceable(tmp_path / "file" / "below" / "out")
    check_replaceable(tmp_path / "not" / "there" / "out")
    with pytest.raises(InputError):
        check_replaceable(Path("/"), {"model.onnx"})
    if not sys.platform.startswith("linux") or not shutil.which("unshare"):
        pytest.skip("no disk that is read alone can be mounted here")
    mount = ["unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o ro small "$0" && exec "$@"', str(tmp_path)]
    done = python(f"check_replaceable(Path({str(tmp_path)!r}) / 'out')", *mount)
    if "mount" in done.stderr:
        pytest.skip("no disk can be mounted here")
    assert "cannot be written; name another folder" in done.stderr


def test_what_is_unfinished_goes_through_no_link(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / ".out.partial").symlink_to(elsewhere)
    with (
        pytest.raises(InputError, match="is a link"),
        alone(tmp_path / ".out.partial", tmp_path / "out"),
    ):
        pass
    (elsewhere / "kept").write_text("kept")
    (tmp_path / ".new.partial").symlink_to(elsewhere / "kept")
    with whole(tmp_path / "new") as scratch:
        scratch.write_text("new")
    assert (tmp_path / "new").read_text() == "new"
    assert (elsewhere / "kept").read_text() == "kept"

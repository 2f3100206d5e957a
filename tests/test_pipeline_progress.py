"""Progress where no person watches: lines with the time left, and none of what is quick."""

import time

import pytest

from softslide.pipeline import progress


def test_long_work_writes_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setattr(progress, "LINE_S", 0.3)
    for _ in progress.progress_bar("solving", "line", range(10)):
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 4
    assert all(line.startswith("solving:") and "/10 [" in line and "line/s" in line for line in lines)


def test_quick_work_writes_none(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.progress_bar("training", "step") as bar:
        bar.reset(3)
        bar.set_description("again")
        bar.update(3)
    assert capsys.readouterr().err == ""

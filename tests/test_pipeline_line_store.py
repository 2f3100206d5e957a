"""Finished lines of a solve on disk, shared by several solves of one design."""

from pathlib import Path

import numpy as np
import pytest

from softslide.features.errors import InputError
from softslide.pipeline.atlas.line_store import LineStore
from softslide.pipeline.skin.lines import Line

TASKS = [(0, depth, Line(0, 1, 1.0)) for depth in range(3)]


def test_lines_are_found_and_removed_with_their_key_alone(tmp_path: Path) -> None:
    one, two = LineStore(tmp_path / "work", {"design": 1}), LineStore(tmp_path / "work", {"design": 2})
    one.keep(TASKS[0], np.arange(6.0).reshape(2, 3), {"steps": 4.0})
    assert two.finished(TASKS) == {}
    two.remove()
    ((task, (values, statistics)),) = LineStore(tmp_path / "work", {"design": 1}).finished(TASKS).items()
    assert (task, statistics) == (TASKS[0], {"steps": 4.0})
    np.testing.assert_array_equal(values, np.arange(6.0).reshape(2, 3))


def test_a_solve_that_ends_first_does_not_take_the_other_s_folder(tmp_path: Path) -> None:
    """Two trainings of one design: the first to end removes the lines, and the other one goes on."""
    first, other = (LineStore(tmp_path / "work", "key") for _ in range(2))
    first.keep(TASKS[0], np.zeros(3), {})
    first.remove()
    assert not (tmp_path / "work").exists()
    assert other.finished(TASKS) == {}
    for task in TASKS:
        other.keep(task, np.ones(3), {})
    assert set(other.finished(TASKS)) == set(TASKS)
    other.remove()
    first.remove()
    assert not (tmp_path / "work").exists()


def test_a_place_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "work").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        LineStore(tmp_path / "work", "key")

"""A TOML file becomes a dataclass as it says, or one line names the file, the key, what is wrong and the remedy."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from softslide.features.errors import InputError
from softslide.pipeline.toml_tables import DEEPEST, MOST_BYTES, changed, from_table, read_toml


@dataclass(frozen=True)
class Board:
    name: str
    x_mm: float
    gain: float = 1.0

    def __post_init__(self) -> None:
        if not self.gain > 0:
            raise ValueError(f"gain is {self.gain}; it must be positive")


@dataclass(frozen=True)
class Rig:
    steps: int
    boards: tuple[Board, ...] = field(metadata={"key": "board"})
    source: Path
    size_mm: tuple[float, float] = (1.0, 2.0)
    levels: tuple[int, ...] = ()
    dry: bool = False
    lid: Board | None = None
    value: str | float | None = None
    named: dict[str, Board] = field(default_factory=dict)
    words: dict[str, str | float] = field(default_factory=dict)


GOOD = """
steps = 3
size_mm = [4, 5.5]
levels = [1, 2, 3]
dry = true
value = "fast"
words = { XF = 0, XB = "back" }
[[board]]
name = "a"
x_mm = 1
[[board]]
name = "b"
x_mm = 2.5
gain = 2
[lid]
name = "l"
x_mm = -1
[named.first]
name = "f"
x_mm = 0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def rig(path: Path) -> Rig:
    return from_table(Rig, read_toml(path), str(path), source=path)


def test_every_kind_of_field_is_read(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    found = rig(path)
    boards = (Board("a", 1.0), Board("b", 2.5, 2.0))
    words: dict[str, str | float] = {"XF": 0.0, "XB": "back"}
    lid, named = Board("l", -1.0), {"first": Board("f", 0.0)}
    assert found == Rig(3, boards, path, (4.0, 5.5), (1, 2, 3), True, lid, "fast", named, words)
    assert isinstance(found.boards[0].x_mm, float)


def test_a_default_keeps_what_the_table_does_not_name(tmp_path: Path) -> None:
    first = rig(written(tmp_path, GOOD))
    later = changed(first, {"steps": 9, "lid": {"gain": 5}}, "here")
    assert (later.steps, later.lid) == (9, Board("l", -1.0, 5.0))
    assert (later.boards, later.value) == (first.boards, first.value)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("steps = 3", "", ": steps is missing; add it"),
        ("steps = 3", "step = 3", ": unknown key 'step'; known are steps, board, size_mm"),
        ("steps = 3", "steps = 3\nsource = 'x'", ": unknown key 'source'"),
        ("steps = 3", "steps = 3.0", ": steps is 3.0; write a whole number"),
        ("steps = 3", "steps = true", ": steps is True; write a whole number"),
        ("steps = 3", 'steps = 3\n"a\\nb" = 1', r": unknown key 'a\nb'"),
        ("dry = true", "dry = 1", ": dry is 1; write true or false"),
        ("[4, 5.5]", "[4, 'x']", ": size_mm is 'x'; write a number"),
        ("[4, 5.5]", "[4]", ": size_mm holds 1, not 2; write two values in brackets"),
        ("[4, 5.5]", "4", ": size_mm is 4; write a list"),
        ("[1, 2, 3]", "[1, 2.5]", ": levels is 2.5; write a whole number"),
        ('value = "fast"', "value = [1]", ": value is [1]"),
        ("XF = 0", "XF = [0]", ": words.XF is [0]"),
        ("x_mm = 2.5", "x_mm = '2.5'", ": board 2: x_mm is '2.5'; write a number"),
        ("x_mm = 2.5", "", ": board 2: x_mm is missing; add it"),
        ("gain = 2", "gain = -2", ": board 2: gain is -2.0; it must be positive"),
        ("gain = 2", "gian = 2", ": board 2: unknown key 'gian'; known are name, x_mm, gain"),
        ("[lid]", "[lid.inner]", ": lid: unknown key 'inner'"),
        ("[named.first]\nname", "[named]\nfirst = 3\n[other]\nname", ": unknown key 'other'"),
        ('[named.first]\nname = "f"\nx_mm = 0', "[named]\nfirst = 3", ": named.first is 3; write a table"),
        ("steps = 3", "steps = ", ": not a TOML file"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in GOOD
    path = written(tmp_path, GOOD.replace(old, new))
    with pytest.raises(InputError) as error:
        rig(path)
    assert str(error.value).startswith(f"{path}{says}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = nan", "a is nan; write a finite number"),
        ("a = [1.0, [-inf]]", "a: 2: 1 is -inf; write a finite number"),
        (f"a = {2**63}", "a is an integer beyond 64 bits"),
        (f"a = {'9' * 5000}", "not a TOML file"),
        ("a = " + "[" * 20_000 + "]" * 20_000, "nested too deep"),
        (".".join("a" * 5000) + " = 1", "nested too deep"),
        ("a = " + "[" * DEEPEST + "1" + "]" * DEEPEST, "nested too deep"),
        ("#" * (MOST_BYTES + 1), "larger than 1.05 MB"),
    ],
    ids=["nan", "inf", "64 bits", "digits", "lists", "dots", "levels", "bytes"],
)
def test_a_file_out_of_bounds_is_refused(tmp_path: Path, text: str, says: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_toml(path)
    assert str(error.value).startswith(str(path))
    assert says in str(error.value)
    assert len(str(error.value)) < 500


def test_the_bounds_themselves_are_read(tmp_path: Path) -> None:
    lists = "[" * (DEEPEST - 1) + "1" + "]" * (DEEPEST - 1)
    text = f"low = {-(2**63)}\nhigh = {2**63 - 1}\nlists = {lists}\n"
    text += "#" * (MOST_BYTES - len(text))
    assert read_toml(written(tmp_path, text))["high"] == 2**63 - 1


def test_what_is_not_a_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    for name, says in (
        ("pipe.toml", "not a regular file; name another"),
        (".", "not a regular file; name another"),
        ("none.toml", "no such file; name another"),
        ("bytes.toml", "not a TOML file"),
    ):
        with pytest.raises(InputError, match=f"{tmp_path / name}: {says}"):
            read_toml(tmp_path / name, "name another")

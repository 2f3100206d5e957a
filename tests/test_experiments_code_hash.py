"""The hash of code: what a statement does counts, wherever it is imported from; prose does not."""

from pathlib import Path

import pytest

from softslide.experiments.code_hash import ROOMS, code_hash

ENTRY = ["softslide.experiments.entry"]
LEVEL = '''"""What a level is."""

def level(volts):
    """Its mean."""
    from softslide.features.gain import GAIN  # found in a function, too

    return GAIN * sum(volts)
'''


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An entry that imports a module, which imports another and names a file of data; and one that nobody imports."""
    monkeypatch.setattr("softslide.experiments.code_hash.ROOT", tmp_path)
    for room in ROOMS:
        (tmp_path / room).mkdir()
    files = {
        "experiments/entry.py": "from pipeline import level\nimport json\n",
        "pipeline/__init__.py": "",
        "pipeline/level.py": LEVEL,
        "features/gain.py": 'GAIN = 2.0\nLIMITS = "limits.toml"\nOTHER = "no such.toml"\n',
        "features/limits.toml": "low = 1\n",
        "models/other.py": "x = 1\n",
    }
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("experiments/entry.py", "import json", "import math"),
        ("pipeline/level.py", "sum(volts)", "max(volts)"),
        ("pipeline/level.py", "def level(volts)", "def level(volts, *, n=0)"),
        ("features/gain.py", "2.0", "2.5"),
        ("features/limits.toml", "1", "2"),
        ("pipeline/__init__.py", "", "x = 1\n"),
    ],
)
def test_a_statement_and_a_file_of_data_count(tree: Path, name: str, old: str, new: str) -> None:
    before = code_hash(ENTRY)
    path = tree / name
    path.write_text(path.read_text().replace(old, new))
    assert code_hash(ENTRY) != before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("pipeline/level.py", "# found in a function, too", "# here"),
        ("pipeline/level.py", '"""Its mean."""', '"""The mean of it, in V."""'),
        ("pipeline/level.py", '    """Its mean."""\n', ""),
        ("pipeline/level.py", '"""What a level is."""\n\n', ""),
        ("pipeline/level.py", "GAIN * sum(volts)", "(\n        GAIN * sum(volts)\n    )"),
        ("models/other.py", "1", "2"),
    ],
)
def test_prose_layout_and_what_is_not_imported_do_not(tree: Path, name: str, old: str, new: str) -> None:
    before = code_hash(ENTRY)
    path = tree / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert code_hash(ENTRY) == before


def test_without_names_it_is_that_of_all(tree: Path) -> None:
    before = code_hash()
    (tree / "models" / "other.py").write_text("x = 2\n")
    assert code_hash() != before


def test_a_file_is_named_by_its_path(tree: Path) -> None:
    (tree / "docs").mkdir()
    (tree / "docs" / "six.toml").write_text("a = 1\n")
    before = code_hash(["softslide.models.other", "docs/six.toml"])
    (tree / "docs" / "six.toml").write_text("a = 2\n")
    assert code_hash(["softslide.models.other", "docs/six.toml"]) != before


@pytest.mark.parametrize("name", ["softslide.models.none", "docs/none.toml"])
def test_what_is_not_there_is_named(tree: Path, name: str) -> None:
    with pytest.raises(ValueError, match=f"holds no {name}"):
        code_hash([name])

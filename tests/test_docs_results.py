"""The tables of README.md and docs/results.md are what docs/results.json gives, and every figure has its command."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

import softslide
from experiments.bench.documents import keys_of, read_results, read_tables, rewrite

ROOT = Path(__file__).parents[1]
RESULTS, TABLES = ROOT / "docs" / "results.json", ROOT / "docs" / "tables.toml"
DOCUMENTS = ("README.md", "docs/results.md")


def test_the_documents_are_what_the_figures_give(tmp_path: Path) -> None:
    results, tables = read_results(RESULTS), read_tables(TABLES)
    shown: set[str] = set()
    for name in DOCUMENTS:
        copy = tmp_path / Path(name).name
        shutil.copy(ROOT / name, copy)
        shown |= set(re.findall(r"<!-- table: ([\w-]+) -->", copy.read_text(encoding="utf-8")))
        assert not rewrite(copy, results, tables), f"{name}: run softslide bench --rewrite"
    assert shown == set(tables)


def test_every_figure_has_its_commands_its_day_and_a_table() -> None:
    results, tables = read_results(RESULTS), read_tables(TABLES)
    for name, source in results.items():
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", source["date"])
        assert source["commands"]
        for command in source["commands"]:
            words = shlex.split(re.sub(r"^\w+=\S+ ", "", command))
            if words[0] == "softslide":
                softslide.parser().parse_args(words[1:])
        assert keys_of(name, tables.values())


@pytest.fixture
def claims(tmp_path: Path) -> Path:
    """A results.json of two figures, its tables, and a document."""
    source = {
        "commands": ["softslide bench"],
        "date": "2026-01-01",
        "figures": {"splits/a/mean": 0.12345, "share": 1},
    }
    (tmp_path / "results.json").write_text(json.dumps({"lab": source}))
    rows = "| split | error, held |\\n|---|---|\\n| `@` | {lab/splits/@/mean:2} mm, {lab/share:%} % |\\n"
    (tmp_path / "tables.toml").write_text(f'[errors]\neach = ["a"]\nrows = "{rows}"\n')
    (tmp_path / "page.md").write_text("Before.\n<!-- table: errors -->\nold\n<!-- end of table -->\nAfter.\n")
    return tmp_path / "results.json"


def bench(results: Path, *options: str) -> int:
    return softslide.main(["bench", "--results", str(results), *options])


def test_a_table_is_written_once_and_then_stays(claims: Path) -> None:
    page = claims.with_name("page.md")
    assert bench(claims, "--rewrite", str(page)) == 0
    first = page.read_text()
    assert first == (
        "Before.\n<!-- table: errors -->\n| split | error, held |\n|---|---|\n| `a` | 0.12 mm, 100 % |\n"
        "<!-- end of table -->\nAfter.\n"
    )
    assert bench(claims, "--rewrite", str(page)) == 0
    assert page.read_text() == first


def test_an_evaluation_gives_the_figures_that_tables_show(
    claims: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lab = claims.with_name("lab")
    lab.mkdir()
    metrics = {
        "splits": {"a": {"mean": 0.5, "max": 9.0}},
        "share": 0.8,
        "bounds": [{"name": "speed", "measured": 1.0}],
    }
    (lab / "metrics.json").write_text(json.dumps(metrics))
    assert bench(claims, "--evaluated", f"lab={lab}") == 0
    source = read_results(claims)["lab"]
    assert source["figures"] == {"splits/a/mean": 0.5, "share": 0.8}
    assert source["commands"] == ["softslide bench"]
    assert source["date"] > "2026-01-01"
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == {"lab": source}


@pytest.mark.parametrize(
    ("break_it", "says"),
    [
        (lambda place: (place / "page.md").write_text("<!-- table: errors -->\nno end\n"), "not closed"),
        (
            lambda place: (place / "page.md").write_text(
                "<!-- table: errors -->\nnew\n" + (place / "page.md").read_text()
            ),
            "not closed",
        ),
        (
            lambda place: (place / "page.md").write_text("<!-- table: x -->\n<!-- end of table -->\n"),
            "no table 'x'",
        ),
        (lambda place: (place / "page.md").unlink(), "page.md"),
        (lambda place: (place / "results.json").write_text('{"lab": {}}'), "commands, date and figures"),
        (
            lambda place: (place / "results.json").write_text(
                '{"lab": {"commands": [], "date": "", "figures": {}}}'
            ),
            "no figure 'splits/a/mean' of 'lab'",
        ),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    claims: Path, capsys: pytest.CaptureFixture[str], break_it, says: str
) -> None:
    break_it(claims.parent)
    assert bench(claims, "--rewrite", str(claims.with_name("page.md"))) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert says in told

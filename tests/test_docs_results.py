"""The tables of README.md and docs/results.md are what docs/results.json gives, and every figure has its command and is
of the present code, or the document says that it is not."""

import json
import re
import shlex
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from softslide.command_line import parser
from softslide.experiments.bench import (
    figures_in,
    filled,
    hash_of,
    keys_of,
    main,
    outdated,
    read_results,
    read_tables,
    rewrite,
    take,
)
from softslide.experiments.code_hash import ROOMS

ROOT = Path(__file__).parents[1]
RESULTS, TABLES = ROOT / "docs" / "results.json", ROOT / "docs" / "tables.toml"
DOCUMENTS = ("README.md", "docs/results.md")
UNWRITTEN = "Before.\n<!-- table: errors -->\nold\n<!-- end of table -->\nAfter.\n"


def test_the_documents_are_what_the_figures_give(tmp_path: Path) -> None:
    results, tables = read_results(RESULTS), read_tables(TABLES)
    shown: set[str] = set()
    for name in DOCUMENTS:
        copy = tmp_path / Path(name).name
        shutil.copy(ROOT / name, copy)
        shown |= set(re.findall(r"<!-- table: ([\w-]+) -->", copy.read_text(encoding="utf-8")))
        assert not rewrite(copy, results, tables), f"{name}: run python -m softslide.experiments.bench"
    assert shown == set(tables)


def test_no_table_of_figures_stands_outside_the_marks() -> None:
    for name in DOCUMENTS:
        text = re.sub(
            r"<!-- table: .*?<!-- end of table -->", "", (ROOT / name).read_text(encoding="utf-8"), flags=re.S
        )
        assert not re.findall(r"^\|.*\d (?:%|deg\b|mm\b|ms\b).*$", text, re.M), name


def test_every_figure_has_its_commands_its_day_and_a_table() -> None:
    results, tables = read_results(RESULTS), read_tables(TABLES)
    for name, source in results.items():
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", source["date"])
        assert source["commands"]
        for command in source["commands"]:
            words = shlex.split(re.sub(r"^\w+=\S+ ", "", command))
            if words[0] == "softslide":
                parser().parse_args(words[1:])
            if words[0] == "python":
                assert find_spec(words[2])
        assert keys_of(name, tables)


def test_no_figure_is_of_earlier_code_unless_its_source_says_so() -> None:
    results = read_results(RESULTS)
    silent = [name for name in outdated(results) if "stale" not in results[name]]
    assert not silent, "run python -m softslide.experiments.bench with --renew, or with --mark and the reason"


@pytest.fixture
def claims(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A results.json of two figures, its tables, a document, and the code that the figures depend on."""
    for room in ROOMS:
        (tmp_path / room).mkdir()
    (tmp_path / "models" / "level.py").write_text("LEVEL = 1  # V\n")
    monkeypatch.setattr("softslide.experiments.code_hash.ROOT", tmp_path)
    source = {
        "commands": ["A=1 python -m study --json lab.json"],
        "date": "2026-01-01",
        "code": ["softslide.models.level"],
        "hash": hash_of({"code": ["softslide.models.level"]}),
        "figures": {"splits/a/mean": 0.12345, "share": 1},
    }
    (tmp_path / "results.json").write_text(json.dumps({"lab": source}))
    rows = "| split | error, held |\\n|---|---|\\n| `@` | {lab/splits/@/mean:2} mm, {lab/share:%} % |\\n"
    (tmp_path / "tables.toml").write_text(f'[errors]\neach = ["a"]\nrows = "{rows}"\n')
    (tmp_path / "page.md").write_text(UNWRITTEN)
    return tmp_path / "results.json"


def call(results: Path, *options: str) -> int:
    return main(options, results, [results.with_name("page.md")])


def test_a_table_is_written_once_and_then_stays(claims: Path) -> None:
    page = claims.with_name("page.md")
    assert call(claims) == 0
    first = page.read_text()
    assert first == (
        "Before.\n<!-- table: errors -->\n| split | error, held |\n|---|---|\n| `a` | 0.12 mm, 100 % |\n"
        "<!-- end of table -->\nAfter.\n"
    )
    assert call(claims) == 0
    assert page.read_text() == first


def test_figures_of_earlier_code_are_found_and_shown_as_such(
    claims: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = claims.with_name("models") / "level.py"
    code.write_text('"""A level."""\nLEVEL = 1\n')
    assert call(claims, "--stale") == 0
    assert capsys.readouterr().out == ""
    code.write_text("LEVEL = 2\n")
    assert outdated(read_results(claims)) == ["lab"]
    assert call(claims, "--stale") == 1
    assert capsys.readouterr().out == "lab: 2026-01-01: not marked\n"
    assert call(claims, "--mark", "another level") == 0
    said = "*`lab`: measured with an earlier version of the code (2026-01-01): another level.*"
    page = claims.with_name("page.md")
    assert f"100 % |\n\n{said}\n<!-- end of table -->" in page.read_text()
    assert call(claims, "--stale") == 0
    assert call(claims, "--entered", "lab") == 0
    assert said not in page.read_text()
    assert outdated(read_results(claims)) == []


def test_stale_figures_are_renewed_by_their_commands(
    claims: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The figures are of the code that ran, were it edited meanwhile."""
    results, code = read_results(claims), claims.with_name("models") / "level.py"
    code.write_text("LEVEL = 2\n")
    measured = hash_of(results["lab"])
    ran = []

    def run(words: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        code.write_text("LEVEL = 3\n")
        ran.append((words[1:], options["cwd"], options["env"]["A"]))
        figures = {"splits": {"a": {"mean": 0.5}}, "share": 0.25}
        (options["cwd"] / "lab.json").write_text(json.dumps(figures))
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(subprocess, "run", run)
    (tmp_path / "all" / "bench-a").mkdir(parents=True)
    work = tmp_path / "work"
    assert call(claims, "--renew", "--work", str(work), "--recordings-root", str(tmp_path / "all")) == 0
    assert ran == [(["-m", "study", "--json", "lab.json"], work, "1")]
    assert (work / "bench-a").is_dir()
    source = read_results(claims)["lab"]
    assert source["figures"] == {"splits/a/mean": 0.5, "share": 0.25}
    assert source["hash"] == measured
    assert outdated({"lab": source}) == ["lab"]
    assert call(claims, "--renew", "--work", str(work)) == 2


def test_what_no_command_leaves_is_to_be_entered_by_hand(
    claims: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    claims.write_text(claims.read_text().replace("A=1 python -m study --json lab.json", "make real"))
    assert call(claims, "--renew", "lab", "--work", str(tmp_path / "work")) == 0
    assert "run make real; enter splits/a/mean, share in results.json" in capsys.readouterr().out


def test_figures_over_several_seeds_are_their_range(tmp_path: Path) -> None:
    for n in (0, 1):
        (tmp_path / f"a-{n}").mkdir()
        rows = f"as published,0,{8 + n},{2.5 - n}\nas published,1.5,1,1\nt from the edge,0,1,1\n"
        table = "variant,least_speed_mm_s,slides,speed_percent_mean\n" + rows
        (tmp_path / f"a-{n}" / "variants.csv").write_text(table)
    commands = [f"softslide article --recordings p --out a-{n}" for n in (0, 1)]
    assert figures_in(tmp_path, "lab", commands, {}) == {
        "published/slides": {"min": 8, "max": 9},
        "published/speed_percent_mean": {"min": 1.5, "max": 2.5},
    }


def test_a_source_takes_the_figures_of_each_of_its_scripts(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps({"4": {"offset_mm": 0.2}, "0": {"offset_mm": None}}))
    (tmp_path / "b.json").write_text(json.dumps({"12-planned": {"offset_mm": 0.3}}))
    commands = ["python -m a --json a.json", "softslide plan", "python -m a --plan p --json b.json"]
    found = figures_in(tmp_path, "lab", commands, {})
    assert found == {"4/offset_mm": 0.2, "0/offset_mm": None, "12-planned/offset_mm": 0.3}


def test_a_figure_that_could_not_be_measured_this_time_is_gone() -> None:
    source = {"figures": {"a": 1.0, "b": 2.0}}
    take(source, {"a": None, "c": 3.0000001}, "hash")
    assert source["figures"] == {"b": 2.0, "c": 3.0}


def test_a_table_names_each_stale_source_once() -> None:
    lab = {"figures": {"a": 1.0, "b": 2.0}, "date": "2026-01-01", "stale": "why"}
    table = filled("| {lab/a:2} | {lab/b:2} | {new/c:2} |\n", {"lab": lab, "new": {"figures": {"c": 3.0}}})
    assert table.count("earlier version") == 1


def test_an_evaluation_gives_the_figures_that_tables_show(claims: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    metrics = {
        "splits": {"a": {"mean": 0.5, "max": 9.0}},
        "share": 0.8,
        "bounds": [{"name": "speed", "measured": 1.0}],
    }
    (tmp_path / "out" / "metrics.json").write_text(json.dumps(metrics))
    tables = read_tables(claims.with_name("tables.toml"))
    found = figures_in(tmp_path, "lab", ["softslide evaluate --out out"], tables)
    assert found == {"splits/a/mean": 0.5, "share": 0.8}


EMPTY = {"commands": [], "date": "", "code": [], "hash": "", "figures": {}}


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("page.md", "<!-- table: errors -->\nno end\n", "not closed"),
        ("page.md", f"<!-- table: errors -->\nnew\n{UNWRITTEN}", "not closed"),
        ("page.md", "<!-- table: x -->\n<!-- end of table -->\n", "no table 'x'"),
        ("page.md", None, "page.md"),
        ("results.json", '{"lab": {}}', "commands, date, code"),
        ("results.json", json.dumps({"lab": EMPTY}), "no figure 'splits/a/mean' of 'lab'"),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    claims: Path, capsys: pytest.CaptureFixture[str], file: str, text: str | None, says: str
) -> None:
    if text is None:
        claims.with_name(file).unlink()
    else:
        claims.with_name(file).write_text(text)
    assert call(claims) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert says in said

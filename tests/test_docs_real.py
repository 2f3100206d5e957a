"""docs/real.md: its import maps ask no press that they learn from, and its commands are what `make real` runs."""

import re
import shlex
from importlib.util import find_spec
from pathlib import Path

import pytest

import softslide
from softslide.command_line import parser
from softslide.pipeline.importers.grid.grid_map import read_grid_map
from softslide.pipeline.sensor import read_sensor

ROOT = Path(__file__).parents[1]
PRESSES = ROOT / "pipeline" / "presses"
MAPS = sorted(path for path in PRESSES.glob("*.toml") if not path.name.startswith("sensor"))


@pytest.mark.parametrize("path", MAPS, ids=lambda path: path.stem)
def test_a_map_asks_no_pass_and_no_place_that_it_learns_from(path: Path) -> None:
    mapping = read_grid_map(path)
    assert mapping.sensor.touch_axes == "xyz"
    (learned,) = [split for split in mapping.splits if split.name == "calibration"]
    asked = [split for split in mapping.splits if split is not learned]
    assert asked
    for split in asked:
        assert not set(split.passes) & set(learned.passes)
        assert {split.colour, learned.colour} == {"even", "odd"}


def test_its_commands_are_those_of_make_and_are_understood() -> None:
    text = (ROOT / "docs" / "real.md").read_text(encoding="utf-8")
    shown = re.findall(r"^    ((?:softslide|python) .+)$", text, re.MULTILINE)
    recipe = re.search(
        r"^real:.*\n((?:\t.+\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert recipe is not None
    assert re.findall(r"^\t\$\(BIN\)/(.+)$", recipe.group(1), re.MULTILINE) == shown
    for program, *words in map(shlex.split, shown):
        if program == "softslide":
            parser().parse_args(words)
        else:
            assert find_spec(words[1])


def test_the_presses_that_ship_make_slides_that_check_finds_nothing_wrong_with(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (PRESSES / "few.toml").read_text(encoding="utf-8")
    for name, count in (("120", "12"), ("80", "8")):
        text = text.replace(f"count = {name}", f"count = {count}")
    (tmp_path / "map.toml").write_text(text.replace("sensor-five.toml", str(PRESSES / "sensor-five.toml")))
    command = ["import", str(PRESSES / "run2_20250317_fixed_depth.csv"), "--map", str(tmp_path / "map.toml")]
    assert softslide.main([*command, "--out", str(tmp_path / "out")]) == 0
    assert softslide.main(["check", str(tmp_path / "out")]) == 0
    assert "20 recordings, 0 errors, 0 warnings" in capsys.readouterr().out
    sensor = read_sensor(tmp_path / "out" / "sensor.toml")
    assert sensor.origin == "assembled"

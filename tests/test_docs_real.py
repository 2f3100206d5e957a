"""docs/real.md: its import maps ask no press that they teach, and its commands are what `make real` runs."""

import re
import shlex
from pathlib import Path

import pytest

import softslide
from pipeline.importers.grid.grid_map import read_grid_map

ROOT = Path(__file__).parents[1]
MAPS = sorted(path for path in (ROOT / "docs" / "real").glob("*.toml") if not path.name.startswith("sensor"))


@pytest.mark.parametrize("path", MAPS, ids=lambda path: path.stem)
def test_a_map_asks_no_pass_and_no_place_that_it_teaches(path: Path) -> None:
    mapping = read_grid_map(path)
    assert mapping.sensor.touch_axes == "xyz"
    (taught,) = [split for split in mapping.splits if split.name == "calibration"]
    asked = [split for split in mapping.splits if split is not taught]
    assert asked
    for split in asked:
        assert not set(split.passes) & set(taught.passes)
        assert {split.colour, taught.colour} == {"even", "odd"}


def test_its_commands_are_those_of_make_and_are_understood() -> None:
    text = (ROOT / "docs" / "real.md").read_text(encoding="utf-8")
    told = re.findall(r"^    softslide (.+)$", text, re.MULTILINE)
    recipe = re.search(
        r"^real:.*\n((?:\t.+\n)+)", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert recipe is not None
    made = re.findall(r"^\t\$\(BIN\)/softslide (.+)$", recipe.group(1), re.MULTILINE)
    assert [line.replace("$(PRESSES)", "run2_20250317_fixed_depth.csv") for line in made] == told
    for line in told:
        softslide.parser().parse_args(shlex.split(line))

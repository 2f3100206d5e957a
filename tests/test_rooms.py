"""Each room's sheet: its files and sub-rooms, and the imports between them, which never run in a circle."""

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest

ROOMS = ("features", "pipeline", "models", "experiments", "serve", "commands")


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph(*ROOMS, cache_dir=None, exclude_type_checking_imports=True)


def sheet(imports: grimp.ImportGraph, room: str) -> dict[str, set[str]]:
    """The room's files and sub-rooms, and which of the others each of them imports."""
    boxes = imports.find_children(room)
    arrows: dict[str, set[str]] = {box: set() for box in boxes}
    depth = room.count(".") + 2
    for box in boxes:
        for module in {box, *imports.find_descendants(box)}:
            for imported in imports.find_modules_directly_imported_by(module):
                other = ".".join(imported.split(".")[:depth])
                if other in boxes and other != box:
                    arrows[box].add(other)
    return arrows


def circle(arrows: dict[str, set[str]]) -> list[str]:
    """A circle of imports; empty where there is no circle."""
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        return error.args[1]
    return []


@pytest.mark.parametrize("room", ROOMS)
def test_no_room_s_imports_run_in_a_circle(imports: grimp.ImportGraph, room: str) -> None:
    arrows = sheet(imports, room)
    assert len(arrows) > 1
    assert not circle(arrows)


@pytest.mark.parametrize("room", ["models.response_map", "models.cnn", "pipeline.skin", "pipeline.synthesis"])
def test_no_sub_room_s_imports_run_in_a_circle(imports: grimp.ImportGraph, room: str) -> None:
    arrows = sheet(imports, room)
    assert sum(map(len, arrows.values())) > 2
    assert not circle(arrows)


def test_a_circle_shows() -> None:
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}})) == {"a", "b", "c"}

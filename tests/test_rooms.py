"""Each room's sheet: its files and sub-rooms, and the imports between them, which never run in a circle."""

import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter

import grimp
import pytest
from linked import ROOMS, link

INNER = ("models.response_map", "models.cnn", "pipeline.skin", "pipeline.synthesis")


@pytest.fixture(scope="module")
def imports(tmp_path_factory: pytest.TempPathFactory) -> Iterator[grimp.ImportGraph]:
    folder = tmp_path_factory.mktemp("linked")
    link(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.delitem(sys.modules, "softslide", raising=False)
        yield grimp.build_graph("softslide", cache_dir=None, exclude_type_checking_imports=True)


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


@pytest.mark.parametrize("room", [*ROOMS, "commands", *INNER])
def test_no_room_s_imports_run_in_a_circle(imports: grimp.ImportGraph, room: str) -> None:
    arrows = sheet(imports, f"softslide.{room}")
    assert len(arrows) > 1
    assert not circle(arrows)


def test_a_circle_shows() -> None:
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}})) == {"a", "b", "c"}

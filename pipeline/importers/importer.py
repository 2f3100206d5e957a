"""`softslide import`: a lab's files, or presses on a grid, into a folder of recordings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from softslide.features.errors import InputError
from softslide.pipeline.importers.grid.assemble import import_grid
from softslide.pipeline.importers.grid.grid_map import read_grid_map
from softslide.pipeline.importers.import_map import read_map
from softslide.pipeline.importers.run import Imported, import_files
from softslide.pipeline.toml_tables import read_toml


def import_recordings(
    sources: str | Path | Sequence[str | Path], map: str | Path, out: str | Path
) -> Imported:
    """Imports what a map says of the sources, files or folders to search; an interrupted import resumes.

    Raises:
        InputError: a source, the map or a label is bad; nothing is left then.
    """
    files = [Path(each) for each in ([sources] if isinstance(sources, str | Path) else sources)]
    map, out = Path(map), Path(out)
    if read_toml(map, "name a map, or start from a template").get("kind") != "grid":
        return import_files(files, read_map(map), out)
    if len(files) > 1:
        raise InputError(f"{files[1]}: a grid of presses is one file; import each to a folder")
    folder, notes = import_grid(files[0], read_grid_map(map), out)
    return Imported(out, len(folder), 0, tuple(notes))


def volts_of(files: Sequence[Path], map: Path, out: Path) -> list[Path]:
    """A lab's own files as recordings in V, for a model to read: no label, and of the pattern the parts alone.

    Raises:
        InputError: as an import, or the map leaves signs to labelled slides, which these are not.
    """
    mapping = read_map(map)
    if mapping.signs == "zones":
        raise InputError(
            f'{map}: signs = "zones" needs labelled slides; write "given", and what import flipped under [boards]'
        )
    whole = all(not signal.part for signal in mapping.channels.values())
    pattern = r"(?P<recording>.+)\." if whole else mapping.pattern
    import_files(files, replace(mapping, pattern=pattern, labels={}, sheet=None), out)
    return sorted((out / "slides").iterdir())

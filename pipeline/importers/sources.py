"""A lab's files as recordings: which of them belong together, by the map's pattern."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from softslide.features.errors import InputError, printable
from softslide.features.names import REMEDY, is_plain
from softslide.pipeline.importers.import_map import Label, Map, compiled
from softslide.pipeline.importers.readers.registry import READERS


@dataclass
class Source:
    """One recording's files: part -> path (the part is "" where one file holds everything). groups: of their names."""

    name: str
    groups: dict[str, str]
    files: dict[str, Path] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """The file that stands for all in messages."""
        return next(iter(self.files.values()))

    def stamp(self) -> list[list[Any]]:
        """Of each file its path, its bytes and the time of its last change in ns."""
        return [[str(p), _size_bytes(p), p.stat().st_mtime_ns] for _, p in sorted(self.files.items())]


def find_sources(sources: Sequence[Path], mapping: Map) -> list[Source]:
    """The recordings in files and folders, sorted by name; folders are searched for the map's kind.

    Raises:
        InputError: a source is missing, a file named does not fit the pattern, two files claim one place, a recording's
            name is not plain.
    """
    pattern = compiled(mapping.pattern)
    found: dict[str, Source] = {}
    for source in sources:
        for path in _files(source, mapping.kind):
            # A pattern with a / is looked for in the path below the source.
            below = "/" in mapping.pattern and path != source
            match = pattern.search(path.relative_to(source).as_posix() if below else path.name)
            if match:
                _add(found, path, {key: text or "" for key, text in match.groupdict().items()}, mapping)
            elif path == source:
                raise InputError(
                    f"{path}: its name does not fit the map's pattern '{mapping.pattern}'; correct one"
                )
    if not found:
        kinds = ", ".join(READERS[mapping.kind].suffixes)
        there = kind_of([path for source in sources for path in inside(source)])
        other = there not in ("", mapping.kind)
        remedy = f'the files there are of kind = "{there}"' if other else "name its folder"
        raise InputError(f"{', '.join(map(str, sources))}: no file ({kinds}) fits the map; {remedy}")
    return [found[name] for name in sorted(found)]


def _add(found: dict[str, Source], path: Path, groups: dict[str, str], mapping: Map) -> None:
    """Adds a file to its recording: that of its label, of the pattern's `recording` (where _ stands for /), or of its
    name."""
    label = mapping.labels.get("recording", Label(name="recording"))
    text = groups.get(label.name, "").replace("/", "_") or path.stem
    name, part = str(label.values.get(text, text)), groups.get("part", "")
    if not is_plain(name):
        raise InputError(f"{path}: recording '{printable(name)}': a name holds {REMEDY}")
    files = found.setdefault(name, Source(name, groups)).files
    if part in files:
        raise InputError(f"{path}: recording '{name}' comes from {files[part]} too; separate them in pattern")
    files[part] = path


def inside(source: Path) -> list[Path]:
    """A file itself; all that a folder holds, at any depth, sorted.

    Raises:
        InputError: there is no such file or folder.
    """
    if not source.exists():
        raise InputError(f"{source}: no such file or folder; name one that exists")
    return sorted(source.rglob("*")) if source.is_dir() else [source]


def kind_of(files: Sequence[Path]) -> str:
    """The kind of most of the files, by their endings; empty where none is known."""
    known = {ending: kind for kind, reader in READERS.items() for ending in reader.suffixes}
    kinds = Counter(known[path.suffix.lower()] for path in files if path.suffix.lower() in known)
    return max(kinds, key=kinds.__getitem__, default="")


def _files(source: Path, kind: str) -> list[Path]:
    """A file itself; a folder's files of the kind. The folder of a ROS 2 bag is one source."""
    paths = inside(source)
    if not source.is_dir() or (kind == "ros" and (source / "metadata.yaml").exists()):
        return [source]
    bags = [path for path in paths if kind == "ros" and (path / "metadata.yaml").is_file()]
    files = [path for path in paths if path.is_file() and path.suffix.lower() in READERS[kind].suffixes]
    return bags + [path for path in files if path.parent not in bags]


def _size_bytes(path: Path) -> int:
    """Of a file, or of the files in a ROS 2 bag's folder."""
    return sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))

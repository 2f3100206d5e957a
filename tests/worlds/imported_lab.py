"""A lab's files, imported; or refused."""

from pathlib import Path

import pytest
from front_door import refused as refused_command

from softslide.pipeline.importers.run import import_recordings
from softslide.pipeline.recordings.folder import read_folder


def imported(map_path: Path, out: Path, source: Path | None = None):
    """The folder that an import makes, read back."""
    import_recordings([source or map_path.parent / "lab"], map_path, out)
    folder = read_folder(out)
    for name in folder.manifest.index:
        folder.load(name)
    return folder


def refused(map_path: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The front door's one line; nothing is left next to the sources."""
    root = map_path.parent
    before = sorted(root.iterdir())
    said = refused_command(capsys, "import", root / "lab", "--map", map_path, "--out", root / "out")
    assert sorted(root.iterdir()) == before
    return said

"""The package by links, its rooms in one folder as installed: for tools that read it without importing it.

`python tests/worlds/linked.py FOLDER` makes it anew.
"""

import os
import shutil
import sys
from pathlib import Path

from softslide import ROOMS as ROOMS

ROOT = Path(__file__).parents[2]


def link(folder: Path) -> None:
    """Puts softslide into the folder, which is emptied first."""
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("softslide", *ROOMS):
        place = folder / "softslide" / ("" if name == "softslide" else name)
        shutil.copytree(ROOT / name, place, copy_function=os.symlink, dirs_exist_ok=True)


if __name__ == "__main__":
    link(Path(sys.argv[1]))

"""Environments of their own for packages that do not go with this project's: arrays go over in files."""

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from features.errors import InputError
from pipeline.atlas.library import cache_folder

# aeon, and what it needs in releases that go together.
AEON = (
    "aeon==1.6.0",
    "numba==0.63.1",
    "numpy==2.3.5",
    "pandas==3.0.6",
    "scikit-learn==1.9.1",
    "scipy==1.17.1",
)


def variables() -> dict[str, str]:
    """The environment variables of a script there: one thread, and none of this project's packages."""
    one_thread = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA")}
    return {**os.environ, **one_thread, "PYTHONPATH": ""}


def environment(name: str, packages: Sequence[str]) -> Path:
    """The Python of an environment with these packages, built once and kept in the user's cache folder.

    Raises:
        InputError: it cannot be built.
    """
    folder = cache_folder() / name
    python, built = folder / "bin" / "python", folder / "built"
    wanted = "\n".join(packages)
    if built.exists() and built.read_text(encoding="utf-8") == wanted:
        return python
    print(f"{name}: building its environment in {folder}", file=sys.stderr)
    commands: list[list[str | Path]] = [
        [sys.executable, "-m", "venv", "--clear", folder],
        [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages],
    ]
    for command in commands:
        try:
            subprocess.run(command, check=True, capture_output=True, text=True)
        except (OSError, subprocess.CalledProcessError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()[-1]
            raise InputError(f"{folder}: no environment for {name} ({said}); leave it out") from None
    # Written last: an incomplete environment lacks it and is built again.
    built.write_text(wanted, encoding="utf-8")
    return python

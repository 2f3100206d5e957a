"""Writes hashes.txt: what `pip install` takes for softslide[all] here, each with the SHA-256 of its file.

For this system and this Python alone; torch is the build that the index at hand has. To install just these files:

    pip install --require-hashes -r hashes.txt && pip install --no-deps .

    python -m softslide.experiments.studies.hashes
"""

import json
import subprocess
import sys
from collections.abc import Sequence

from softslide.experiments.code_hash import ROOT
from softslide.experiments.studies.script import write_page

PAGE = ROOT / "hashes.txt"
WORDS = ("install", "--dry-run", "--ignore-installed", "--quiet", "--report", "-", "-c", "constraints.txt")


def hashed() -> str:
    """The lines of hashes.txt, of a dry run of pip. It loads what it has not loaded before: minutes."""
    command = [sys.executable, "-m", "pip", *WORDS, ".[all]"]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    lines = []
    for package in json.loads(done.stdout)["install"]:
        name, version = (package["metadata"][key] for key in ("name", "version"))
        if name != "softslide":
            digest = package["download_info"]["archive_info"]["hashes"]["sha256"]
            lines.append(f"{name}=={version} --hash=sha256:{digest}\n")
    return "".join(sorted(lines, key=str.lower))


def main(argv: Sequence[str] | None = None) -> int:
    """The script."""
    return write_page("hashes", __doc__, PAGE, hashed, argv)


if __name__ == "__main__":
    sys.exit(main())

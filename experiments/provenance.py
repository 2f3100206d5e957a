"""What a result was made from: hashes of recordings and bundle, the code, the packages, the computer."""

import hashlib
import json
import os
import platform
import subprocess
from dataclasses import asdict
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from softslide.experiments.code_hash import code_hash
from softslide.pipeline.recordings.folder import Folder


def data_hashes(folder: Folder) -> dict[str, str]:
    """SHA-256 of what a folder's recordings hold: sensor, labels as used, and all slides in their order.

    Where the base's motion is taken out of them, of how, too.
    """
    slides = hashlib.sha256()
    for file in folder.manifest["file"]:
        slides.update(hashlib.sha256((folder.root / file).read_bytes()).digest())
    motion = folder.base_motion
    base = {} if motion is None else {"base": hashlib.sha256(json.dumps(asdict(motion)).encode()).hexdigest()}
    return {
        **base,
        "sensor": hashlib.sha256((folder.root / "sensor.toml").read_bytes()).hexdigest(),
        "manifest": hashlib.sha256(folder.manifest.to_csv().encode()).hexdigest(),
        "slides": slides.hexdigest(),
    }


def data_tags(hashes: dict[str, str]) -> dict[str, str]:
    """`data_hashes` as tags of a run."""
    return {f"data.{name}": digest for name, digest in hashes.items()}


def bundle_hash(bundle: Path) -> str:
    """SHA-256 of a bundle's card, which holds its graph's: what a bundle is known by in the store."""
    return hashlib.sha256((bundle / "model.json").read_bytes()).hexdigest()


@cache
def code_revision() -> str:
    """The commit that runs, where files differ from it with `+` and their hash; `unknown` outside a clone."""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(here), *arguments], capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        changed = git("status", "--porcelain", "-uno")
        return git("rev-parse", "HEAD") + (f"+{code_hash()[:12]}" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


@cache
def packages() -> str:
    """Every installed package with its version, a line each, as a constraints file for pip."""
    found = {each.metadata["Name"]: each.version for each in distributions()}
    return "".join(f"{name}=={found[name]}\n" for name in sorted(found, key=str.lower))


def machine() -> dict[str, Any]:
    """The computer: system, processor, cores, Python."""
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
    }


def _processor() -> str:
    """The processor's name: on Linux as the kernel names it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()

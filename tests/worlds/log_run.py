"""Logs a run as a training does, from a process of its own: python log_run.py BUNDLE NAME."""

import sys
from pathlib import Path

from softslide.experiments.provenance import bundle_hash
from softslide.experiments.tracking import tracked


def log_run(bundle: Path, name: str, store: str | None = None, midway=lambda: None) -> None:
    """midway: called when the run has begun and before its bundle is logged."""
    configuration = {"model": "small", "settings": {"seed": 1}}
    with tracked("train", name, configuration, tags={"member": name}, store=store) as run:
        run.losses({0: 2.0, 50: 1.0})
        midway()
        run.files(bundle, "bundle")
        run.tags({"bundle": bundle_hash(bundle)})
        run.metrics({"parity": 1e-6})
        run.register({"bundle": bundle_hash(bundle)})


if __name__ == "__main__":
    log_run(Path(sys.argv[1]), sys.argv[2])

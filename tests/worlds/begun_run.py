"""Begins a run and waits for its own end: python begun_run.py FOLDER."""

import sys
import time
from pathlib import Path

from experiments.tracking.run import tracked

if __name__ == "__main__":
    with tracked("train", "begun", {}, Path(sys.argv[1]) / "out"):
        print("begun", flush=True)
        time.sleep(600)

"""Features of other packages beside this project's: catch22 (Lubba et al. 2019) as in aeon, tsfresh, tsfel.

Their cost alone is measured, in an environment of their own: what models make of them is another question.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from experiments.own_environment import AEON, environment, variables
from features.errors import InputError

PACKAGES = (*AEON, "tsfel==0.2.0", "tsfresh==0.21.2")
SCRIPT = Path(__file__).with_name("feature_peers_script.py")


def peers_ms(samples: np.ndarray) -> dict[str, float]:
    """Core-ms a window of each package's features, of samples (n, 3, N) V; none, and why, where they cannot be had."""
    try:
        python = environment("feature-peers", PACKAGES)
    except InputError as error:
        print(f"{error}: features are not compared", file=sys.stderr)
        return {}
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "given.npy"
        np.save(given, samples)
        done = subprocess.run(
            [python, SCRIPT, given],
            env=variables(),
            capture_output=True,
            text=True,
        )
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        print(f"features of other packages: {said}: features are not compared", file=sys.stderr)
        return {}
    return json.loads(done.stdout.splitlines()[-1])

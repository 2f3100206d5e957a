"""Cost of a window's features, next to those of other packages: catch22 (Lubba et al. 2019) in aeon, tsfresh, tsfel.

Prints core-ms a window of 3 x 2048 samples: averaged over the runtime's bins, then the feature vector, in batches of
256; for what the bins and a batch save, the features of all samples, and of one window at a time; then the other
packages', of all samples. Their environment is built in the user's cache folder.

    OMP_NUM_THREADS=1 python -m experiments.studies.feature_speed --json features.json
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

WINDOWS, SAMPLES, RUNS, RATE_HZ = 256, 2048, 7, 100.0
PACKAGES = ("tsfel==0.2.0", "tsfresh==0.21.2")


def core_ms(extract: Callable[[np.ndarray], object], samples: np.ndarray) -> float:
    """A window of samples (n, 3, N) V, median over RUNS after one that is not counted: it compiles and imports."""
    extract(samples[:1])
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        extract(samples)
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times)) / len(samples)


def own_ms(samples: np.ndarray) -> Iterator[tuple[str, float]]:
    """The figures of this project's features."""
    from features.vector.feature_vector import feature_matrix
    from features.window import WINDOW_BINS

    def features(volts: np.ndarray) -> object:
        return feature_matrix(volts, np.full(len(volts), 5.0))

    def binned(volts: np.ndarray) -> object:
        return features(volts.reshape(*volts.shape[:2], WINDOW_BINS, -1).mean(axis=-1))

    yield "features_ms", core_ms(binned, samples)
    yield "features_of_all_samples_ms", core_ms(features, samples)
    yield "features_one_window_at_a_time_ms", core_ms(lambda volts: [binned(v[None]) for v in volts], samples)


def peers_ms(samples: np.ndarray) -> Iterator[tuple[str, float]]:
    """The other packages' figures: this file runs as a script of their environment."""
    from experiments.own_environment import AEON, environment, variables
    from features.errors import InputError

    python = environment("feature-peers", (*AEON, *PACKAGES))
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "given.npy"
        np.save(given, samples)
        words = [str(python), __file__, "--peers", str(given)]
        done = subprocess.run(words, env=variables(), capture_output=True, text=True)
    if done.returncode:
        raise InputError(f"other packages: {done.stderr.strip().splitlines()[-1]}; leave them out with --own")
    yield from json.loads(done.stdout.splitlines()[-1]).items()


def peers(samples: np.ndarray) -> dict[str, float]:
    """In their environment. Slow ones take fewer windows."""
    import pandas as pd
    import tsfel
    from aeon.transformations.collection.feature_based import Catch22
    from tsfresh import extract_features
    from tsfresh.feature_extraction import EfficientFCParameters, MinimalFCParameters

    def tsfresh(volts: np.ndarray, settings: object) -> object:
        table = pd.DataFrame(volts.transpose(0, 2, 1).reshape(-1, 3), columns=list("xyz"))
        table["window"], table["moment"] = np.divmod(np.arange(len(table)), volts.shape[2])
        keys = {"column_id": "window", "column_sort": "moment", "default_fc_parameters": settings}
        return extract_features(table, **keys, n_jobs=0, disable_progressbar=True)

    def tsfel_all(volts: np.ndarray) -> object:
        settings, extract = tsfel.get_features_by_domain(), tsfel.time_series_features_extractor
        return [extract(settings, pd.DataFrame(each.T), fs=RATE_HZ, verbose=0) for each in volts]

    warnings.simplefilter("ignore")
    catch22 = Catch22(catch24=True, replace_nans=True, n_jobs=1).fit_transform
    return {
        "features_catch22_ms": core_ms(catch22, samples[:32]),
        "features_tsfresh_minimal_ms": core_ms(lambda v: tsfresh(v, MinimalFCParameters()), samples[:32]),
        "features_tsfresh_efficient_ms": core_ms(lambda v: tsfresh(v, EfficientFCParameters()), samples[:2]),
        "features_tsfel_ms": core_ms(tsfel_all, samples[:8]),
    }


def main(argv: Sequence[str] | None = None) -> int:
    from experiments.studies.script import Part, parser, run

    words = parser("feature_speed", __doc__)
    words.add_argument("--own", action="store_true", help="this project's features alone")
    s = np.linspace(0.0, 1.0, SAMPLES)
    pulse = 0.15 * np.sin(np.pi * s) ** 2
    slide = np.stack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])
    samples = slide + np.random.default_rng(0).normal(0.0, 1e-3, (WINDOWS, *slide.shape))

    def study(given: argparse.Namespace) -> Iterator[Part]:
        yield from own_ms(samples)
        if not given.own:
            yield from peers_ms(samples)

    return run(words, study, argv)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peers"]:
        print(json.dumps(peers(np.load(sys.argv[2]))))
    else:
        sys.exit(main())

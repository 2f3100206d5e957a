"""Times features of other packages, a script for an environment that has them: core-ms a window as a line of JSON.

python feature_peers_script.py GIVEN.npy, windows (n, C, N). Slow ones take fewer windows; the first call, which
compiles and imports, is not counted.
"""

import json
import sys
import time
import warnings
from collections.abc import Callable

import numpy as np
import pandas as pd
import tsfel
from aeon.transformations.collection.feature_based import Catch22
from tsfresh import extract_features
from tsfresh.feature_extraction import EfficientFCParameters, MinimalFCParameters

RATE_HZ = 100.0
RUNS = 3


def main(path: str) -> None:
    """Times each, and prints."""
    warnings.simplefilter("ignore")
    samples = np.load(path)
    print(
        json.dumps(
            {
                "catch22": core_ms(catch22, samples[:32]),
                "tsfresh_minimal": core_ms(lambda part: tsfresh(part, MinimalFCParameters()), samples[:32]),
                "tsfresh_efficient": core_ms(
                    lambda part: tsfresh(part, EfficientFCParameters()), samples[:2]
                ),
                "tsfel": core_ms(tsfel_all, samples[:8]),
            }
        )
    )


def core_ms(extract: Callable[[np.ndarray], object], samples: np.ndarray) -> float:
    """Median over RUNS."""
    extract(samples[:1])
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        extract(samples)
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times)) / len(samples)


def catch22(samples: np.ndarray) -> object:
    """22 features and, of each channel, mean and spread."""
    return Catch22(catch24=True, replace_nans=True, n_jobs=1).fit_transform(samples)


def tsfresh(samples: np.ndarray, settings: object) -> object:
    """A row a sample and channel, as tsfresh wants them."""
    count, channels, length = samples.shape
    table = pd.DataFrame(
        samples.transpose(0, 2, 1).reshape(-1, channels), columns=[f"c{k}" for k in range(channels)]
    )
    table = table.assign(window=np.repeat(np.arange(count), length), moment=np.tile(np.arange(length), count))
    return extract_features(
        table,
        column_id="window",
        column_sort="moment",
        default_fc_parameters=settings,
        n_jobs=0,
        disable_progressbar=True,
    )


def tsfel_all(samples: np.ndarray) -> object:
    """All its features, window by window."""
    settings = tsfel.get_features_by_domain()
    return [
        tsfel.time_series_features_extractor(settings, pd.DataFrame(window.T), fs=RATE_HZ, verbose=0)
        for window in samples
    ]


if __name__ == "__main__":
    main(*sys.argv[1:])

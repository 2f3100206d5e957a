"""Cost of a window's features.

Prints core-ms a window of 3 x 2048 samples: averaged over the runtime's bins, then the feature vector, in batches of
256; for what the bins and a batch save, the features of all samples, and of one window at a time.

    OMP_NUM_THREADS=1 python -m softslide.experiments.studies.feature_speed --json features.json
"""

import sys
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from softslide.experiments.studies.script import Part, parser, run
from softslide.features.vector.feature_vector import feature_matrix
from softslide.features.window import WINDOW_BINS

WINDOWS, SAMPLES, RUNS = 256, 2048, 7


def core_ms(extract: Callable[[np.ndarray], object], samples: np.ndarray) -> float:
    """A window of samples (n, 3, N) V, median over RUNS after one that is not counted."""
    extract(samples[:1])
    times = []
    for _ in range(RUNS):
        began = time.process_time()
        extract(samples)
        times.append(time.process_time() - began)
    return 1e3 * float(np.median(times)) / len(samples)


def costs() -> Iterator[Part]:
    """Of slides over an accelerometer."""
    s = np.linspace(0.0, 1.0, SAMPLES)
    pulse = 0.15 * np.sin(np.pi * s) ** 2
    slide = np.stack([-pulse * np.cos(np.pi * s), pulse, 0.1 * pulse])
    samples = slide + np.random.default_rng(0).normal(0.0, 1e-3, (WINDOWS, *slide.shape))

    def features(volts: np.ndarray) -> object:
        return feature_matrix(volts, np.full(len(volts), 5.0))

    def binned(volts: np.ndarray) -> object:
        return features(volts.reshape(*volts.shape[:2], WINDOW_BINS, -1).mean(axis=-1))

    yield "features_ms", core_ms(binned, samples)
    yield "features_of_all_samples_ms", core_ms(features, samples)
    yield "features_one_window_at_a_time_ms", core_ms(lambda volts: [binned(v[None]) for v in volts], samples)


def main(argv: Sequence[str] | None = None) -> int:
    return run(parser("feature_speed", __doc__), lambda _: costs(), argv)


if __name__ == "__main__":
    sys.exit(main())

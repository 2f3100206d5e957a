"""MiniRocket and ridge regression, a script for an environment that has aeon: arrays in, arrays out.

python minirocket_regressor.py GIVEN.npz FOUND.npz

GIVEN: waves (n, C, 64) and scales (n, S) of the windows to learn from, their targets (n, K); asked_waves (m, C, 64),
asked_scales (m, S). FOUND: rows (m, K), and window_s (w,), the time each of the first w took on its own, in s.
"""

import sys
import time

import numpy as np
from aeon.transformations.collection.convolution_based import MiniRocket
from sklearn.linear_model import RidgeCV
from sklearn.preprocessing import StandardScaler

TIMED = 100


def main(given_path: str, found_path: str) -> None:
    """Fits, predicts, and times single windows."""
    with np.load(given_path) as file:
        given = dict(file)
    rocket = MiniRocket(random_state=0, n_jobs=1).fit(given["waves"])
    scaler, ridge = StandardScaler(), RidgeCV(np.logspace(-3, 5, 17), alpha_per_target=True)
    target_scale = StandardScaler().fit(given["targets"])

    def features(waves: np.ndarray, scales: np.ndarray) -> np.ndarray:
        return np.hstack([rocket.transform(waves), scales])

    seen = scaler.fit_transform(features(given["waves"], given["scales"]))
    ridge.fit(seen, target_scale.transform(given["targets"]))

    def predict(waves: np.ndarray, scales: np.ndarray) -> np.ndarray:
        return target_scale.inverse_transform(ridge.predict(scaler.transform(features(waves, scales))))

    waves, scales = given["asked_waves"], given["asked_scales"]
    rows = predict(waves, scales)
    window_s = []
    for n in range(min(TIMED, len(waves))):
        begun = time.perf_counter()
        predict(waves[n : n + 1], scales[n : n + 1])
        window_s.append(time.perf_counter() - begun)
    np.savez(found_path, rows=rows, window_s=window_s)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Regressors on the feature vector: extremely randomized trees, a small network, a Gaussian process.

Each estimates the same four numbers: direction as cosine and sine, log(v sigma_t), offset. Energy width times speed
is a length that the line alone decides; the features they read hold no seconds either, so no speed can leak in.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.ensemble import ExtraTreesRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.neural_network import MLPRegressor

from features.vector.energy import energy_width_s
from features.vector.feature_vector import feature_matrix, feature_names
from models.classical.augmentation import with_lines_between
from pipeline.recordings.windows import LabelledWindows

OUTPUTS = ("direction_cos", "direction_sin", "log_speed_width", "offset_mm")
# Each forest's targets, and those of them that are taken from it. Direction and speed fare better alone: what
# splits the one does not split the other. The offset fares better beside the direction: its sign is tied to it.
FORESTS = (((0, 1), (0, 1)), ((2,), (2,)), ((0, 1, 3), (3,)))

# Share of the stroke before which windows are left out of a fit: slides that differ look alike there, and what
# the regressors would learn from them spoils the windows that follow.
EARLIEST = 0.35


def read_columns(accelerometers: int) -> np.ndarray:
    """Columns that the regressors read.

    No seconds: no target depends on them. No V_z: it is mostly pressure ripple. No zones: a zone is a name, not a
    quantity. The curve as shares of its strength alone: in volts it would say the same again, less steadily.
    """
    kept = []
    for k, name in enumerate(feature_names(accelerometers)):
        nuisance = name.endswith("_s") or any(part in name for part in ("vz", "sign", "zone"))
        if not nuisance and not ("_arc_" in name and name.endswith("_v")):
            kept.append(k)
    return np.array(kept)


def taught(windows: LabelledWindows) -> LabelledWindows:
    """The windows that a regressor is fitted to."""
    return windows[windows.stroke_fraction >= EARLIEST]


def float_features(windows: LabelledWindows) -> np.ndarray:
    """Features (n, F) as a graph gets them, rounded to float32."""
    return feature_matrix(windows.volts, windows.elapsed_s).astype(np.float32)


def targets(windows: LabelledWindows) -> np.ndarray:
    """Targets (n, 4) in OUTPUTS order."""
    angle = np.deg2rad(windows.direction_deg)
    width = energy_width_s(windows.volts, windows.elapsed_s)
    return np.stack(
        [np.cos(angle), np.sin(angle), np.log(windows.speed_mm_s * width), windows.offset_mm], axis=1
    )


@dataclass(frozen=True)
class Scale:
    """Mean and standard deviation of columns."""

    mean: np.ndarray
    deviation: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> "Scale":
        """A constant column keeps deviation 1."""
        deviation = values.std(axis=0)
        return cls(values.mean(axis=0), np.where(deviation > 1e-12, deviation, 1.0))

    def standard(self, values: np.ndarray) -> np.ndarray:
        """Values with mean 0 and deviation 1."""
        return (values - self.mean) / self.deviation

    def natural(self, values: np.ndarray) -> np.ndarray:
        """The inverse of `standard`."""
        return values * self.deviation + self.mean


@dataclass(frozen=True)
class Trees:
    """One forest for each of FORESTS over the columns that they read, in the targets' standard units."""

    columns: np.ndarray
    forests: tuple[ExtraTreesRegressor, ...]
    target: Scale

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, 4) of features (n, F)."""
        read = np.asarray(features, np.float32)[:, self.columns]
        standard = np.empty((len(read), len(OUTPUTS)))
        for (grown, taken), forest in zip(FORESTS, self.forests, strict=True):
            rows = forest.predict(read).reshape(len(read), -1)
            standard[:, taken] = rows[:, [grown.index(k) for k in taken]]
        return self.target.natural(standard)


def fit_trees(windows: LabelledWindows, trees: int = 150, least_leaf: int = 6, seed: int = 0) -> Trees:
    """least_leaf: windows that a leaf averages at least; it sets the graph's size."""
    windows = taught(windows)
    columns = read_columns(windows.volts.shape[1] // 3)
    read, target = with_lines_between(windows, float_features(windows)[:, columns], targets(windows))
    scale = Scale.of(target)
    standard = scale.standard(target)
    forests = tuple(
        ExtraTreesRegressor(trees, min_samples_leaf=least_leaf, random_state=seed).fit(
            read, standard[:, grown] if len(grown) > 1 else standard[:, grown[0]]
        )
        for grown, _ in FORESTS
    )
    return Trees(columns, forests, scale)


@dataclass(frozen=True)
class Perceptrons:
    """The mean of a few two-layer networks (tanh) on standardized features."""

    columns: np.ndarray
    input: Scale
    members: tuple[MLPRegressor, ...]
    target: Scale

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, 4) of features (n, F)."""
        standard = self.input.standard(np.asarray(features, np.float64)[:, self.columns])
        return self.target.natural(np.mean([member.predict(standard) for member in self.members], axis=0))


def fit_mlp(
    windows: LabelledWindows,
    members: int = 3,
    hidden: Sequence[int] = (64, 64),
    penalty: float = 0.03,
    iterations: int = 150,
    seed: int = 0,
) -> Perceptrons:
    """penalty: of the squared weights. Each member starts from its own seed."""
    windows = taught(windows)
    columns = read_columns(windows.volts.shape[1] // 3)
    read, target = with_lines_between(
        windows, float_features(windows)[:, columns].astype(np.float64), targets(windows)
    )
    inputs, scale = Scale.of(read), Scale.of(target)
    networks = []
    for member in range(members):
        network = MLPRegressor(
            hidden_layer_sizes=tuple(hidden),
            activation="tanh",
            alpha=penalty,
            max_iter=iterations,
            random_state=seed + member,
        )
        with warnings.catch_warnings():
            # The number of passes is the budget; where they end is no fault.
            warnings.simplefilter("ignore", ConvergenceWarning)
            networks.append(network.fit(inputs.standard(read), scale.standard(target)))
    return Perceptrons(columns, inputs, tuple(networks), scale)


@dataclass(frozen=True)
class Kernel:
    """amplitude * exp(-r^2 / (2 length^2)) weighted by `weights` (n,): one target's mean."""

    amplitude: float
    length: float
    weights: np.ndarray


@dataclass(frozen=True)
class GaussianProcess:
    """Means of Gaussian processes over the same points (n, F'), one a target, in standard units."""

    columns: np.ndarray
    input: Scale
    points: np.ndarray
    kernels: tuple[Kernel, ...]
    target: Scale

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, 4) of features (n, F)."""
        standard = self.input.standard(np.asarray(features, np.float64)[:, self.columns])
        rows = np.empty((len(standard), len(self.kernels)))
        # Row by row: a matrix product's last digits would depend on how many rows it is given.
        for row, here in zip(rows, standard, strict=True):
            square = np.square(self.points - here).sum(axis=1)
            row[:] = [
                (k.amplitude * np.exp(square / (-2.0 * k.length**2)) * k.weights).sum() for k in self.kernels
            ]
        return self.target.natural(rows)


def fit_gp(
    windows: LabelledWindows, search_rows: int = 400, least_noise: float = 1e-5, seed: int = 0
) -> GaussianProcess:
    """A kernel's three constants maximize the likelihood of `search_rows` of the windows.

    least_noise: the noise's variance at least, in units of the target's variance.
    """
    windows = taught(windows)
    columns = read_columns(windows.volts.shape[1] // 3)
    read, target = float_features(windows)[:, columns].astype(np.float64), targets(windows)
    inputs, scale = Scale.of(read), Scale.of(target)
    points, standard = inputs.standard(read), scale.standard(target)
    some = np.random.default_rng(seed).permutation(len(points))[:search_rows]
    prior = ConstantKernel(10.0, (0.1, 1e5)) * RBF(10.0, (1.0, 1e3)) + WhiteKernel(1e-2, (least_noise, 1.0))
    kernels = []
    for goal in standard.T:
        with warnings.catch_warnings():
            # A constant at its bound is a finding, not a fault.
            warnings.simplefilter("ignore", ConvergenceWarning)
            found = GaussianProcessRegressor(prior, alpha=0.0).fit(points[some], goal[some]).kernel_
        process = GaussianProcessRegressor(found, alpha=0.0, optimizer=None).fit(points, goal)
        kernels.append(Kernel(found.k1.k1.constant_value, found.k1.k2.length_scale, process.alpha_))
    return GaussianProcess(columns, inputs, points, tuple(kernels), scale)

"""Gaussian process regression (Rasmussen and Williams 2006) on the feature vector, one process a target."""

import warnings
from dataclasses import dataclass, field

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from softslide.features.stream.conditioning import Conditioning
from softslide.models.classical.fit import feature_model
from softslide.models.classical.learned_lines import SharesConfig
from softslide.models.classical.regression import Regressor, regression_table
from softslide.models.graph.builder import GraphBuilder
from softslide.pipeline.ranges import SEED, check_ranges
from softslide.pipeline.recordings.windows import LabelledWindows


@dataclass(frozen=True)
class GpConfig:
    """search_rows: windows whose likelihood a kernel's three constants maximize. least_noise: the noise's variance at
    least, in units of the target's variance."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    training: SharesConfig = field(default_factory=SharesConfig)
    search_rows: int = 400
    least_noise: float = 1e-5
    seed: int = 0

    def __post_init__(self) -> None:
        # A search solves for its rows ten times over, with their third power.
        check_ranges(self, search_rows=(10, 10_000), least_noise=(1e-12, 1.0), seed=SEED)


@dataclass(frozen=True)
class Kernel:
    """amplitude * exp(-r^2 / (2 length^2)) weighted by `weights` (n,): one target's mean."""

    amplitude: float
    length: float
    weights: np.ndarray


@dataclass(frozen=True)
class GaussianProcess(Regressor):
    """Means of Gaussian processes over the same points (n, F'), one a target."""

    points: np.ndarray
    kernels: tuple[Kernel, ...]

    def standard_rows(self, x: np.ndarray) -> np.ndarray:
        """The means."""
        rows = np.empty((len(x), len(self.kernels)))
        # Row by row: a matrix product's last digits would depend on how many rows it is given.
        for row, here in zip(rows, x, strict=True):
            square = np.square(self.points - here).sum(axis=1)
            row[:] = [
                (k.amplitude * np.exp(square / (-2.0 * k.length**2)) * k.weights).sum() for k in self.kernels
            ]
        return rows

    def standard_nodes(self, g: GraphBuilder, x: str) -> str:
        """|x - x_i|^2 as |x|^2 - 2 x . x_i + |x_i|^2, all points at once, in the float64 that skl2onnx leaves out."""
        own = g.total(g.op("Mul", x, x), 1, keep=True)
        product = g.op("MatMul", x, g.constant(-2.0 * self.points.T))
        square = g.op("Add", g.op("Add", product, own), g.constant(np.square(self.points).sum(axis=1)))
        means = []
        for k in self.kernels:
            kernel = g.op("Exp", g.op("Mul", square, g.constant(-0.5 / k.length**2)))
            means.append(g.op("MatMul", kernel, g.constant(k.amplitude * k.weights[:, None])))
        return g.op("Concat", *means, axis=1)


def fit_gp(windows: LabelledWindows, config: GpConfig) -> GaussianProcess:
    """Fits to the late windows."""
    units, points, goals = regression_table(windows, between_lines=False)
    some = np.random.default_rng(config.seed).permutation(len(points))[: config.search_rows]
    noise = WhiteKernel(1e-2, (config.least_noise, 1.0))
    prior = ConstantKernel(10.0, (0.1, 1e5)) * RBF(10.0, (1.0, 1e3)) + noise
    kernels = []
    for goal in goals.T:
        with warnings.catch_warnings():
            # A constant at its bound is a finding, not a fault.
            warnings.simplefilter("ignore", ConvergenceWarning)
            found = GaussianProcessRegressor(prior, alpha=0.0).fit(points[some], goal[some]).kernel_
        process = GaussianProcessRegressor(found, alpha=0.0, optimizer=None).fit(points, goal)
        kernels.append(Kernel(found.k1.k1.constant_value, found.k1.k2.length_scale, process.alpha_))
    return GaussianProcess(units, points, tuple(kernels))


MODEL = feature_model(GpConfig, fit_gp)

"""A few small networks (multilayer perceptrons, tanh) on the feature vector, averaged."""

import warnings
from dataclasses import dataclass, field

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from softslide.features.stream.conditioning import Conditioning
from softslide.models.classical.fit import feature_model
from softslide.models.classical.learned_lines import SharesConfig
from softslide.models.classical.regression import Regressor, regression_table
from softslide.models.graph.builder import GraphBuilder
from softslide.pipeline.ranges import SEED, SIZE, check_ranges
from softslide.pipeline.recordings.windows import LabelledWindows


@dataclass(frozen=True)
class MlpConfig:
    """members: networks averaged, each from a seed of its own. hidden: their layers. penalty: of squared weights.
    iterations: passes over the data."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    training: SharesConfig = field(default_factory=SharesConfig)
    members: int = 3
    hidden: tuple[int, ...] = (64, 64)
    penalty: float = 0.03
    iterations: int = 150
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.hidden:
            raise ValueError("hidden is empty; give the width of at least one layer")
        check_ranges(
            self, members=(1, 100), hidden=(1, 4096), penalty=SIZE, iterations=(1, 1_000_000), seed=SEED
        )


@dataclass(frozen=True)
class Perceptrons(Regressor):
    """The mean of the members."""

    members: tuple[MLPRegressor, ...]

    def standard_rows(self, x: np.ndarray) -> np.ndarray:
        """The members' mean."""
        return np.mean([member.predict(x) for member in self.members], axis=0)

    def standard_nodes(self, g: GraphBuilder, x: str) -> str:
        """Members side by side, then their mean. skl2onnx gives several targets another shape, so not with it."""
        rows = []
        for member in self.members:
            value = x
            for layer, (weight, bias) in enumerate(zip(member.coefs_, member.intercepts_, strict=True)):
                value = g.op("Add", g.op("MatMul", value, g.constant(weight)), g.constant(bias))
                if layer < len(member.coefs_) - 1:
                    value = g.op("Tanh", value)
            rows.append(value)
        return g.op("Mul", g.op("Sum", *rows), g.constant(1.0 / len(rows)))


def fit_mlp(windows: LabelledWindows, config: MlpConfig) -> Perceptrons:
    """Fits to the late windows and to rows between their lines."""
    units, x, goals = regression_table(windows, between_lines=True)
    networks = []
    for member in range(config.members):
        network = MLPRegressor(
            hidden_layer_sizes=tuple(config.hidden),
            activation="tanh",
            alpha=config.penalty,
            max_iter=config.iterations,
            random_state=config.seed + member,
        )
        with warnings.catch_warnings():
            # The number of passes is the budget; where they end is no fault.
            warnings.simplefilter("ignore", ConvergenceWarning)
            networks.append(network.fit(x, goals))
    return Perceptrons(units, tuple(networks))


MODEL = feature_model(MlpConfig, fit_mlp)

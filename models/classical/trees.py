"""Extremely randomized trees (Geurts, Ernst and Wehenkel 2006) on the feature vector."""

from dataclasses import dataclass, field

import numpy as np
import onnx
from onnx import TensorProto
from skl2onnx import convert_sklearn
from skl2onnx.common.data_types import FloatTensorType
from sklearn.ensemble import ExtraTreesRegressor

from softslide.features.stream.conditioning import Conditioning
from softslide.models.classical.augmentation import with_lines_between
from softslide.models.classical.fit import feature_model
from softslide.models.classical.learned_lines import SharesConfig
from softslide.models.classical.regression import OUTPUTS, Scale, read_windows, targets
from softslide.models.graph.builder import OPSET, OPSET_ML, GraphBuilder
from softslide.pipeline.ranges import SEED, check_ranges
from softslide.pipeline.recordings.windows import LabelledWindows

# Each forest's targets, and those of them that are taken from it. Direction and speed fare better alone: what splits
# the one does not split the other (one forest for all doubles the speed's error, experiments/LOG.md). The offset fares
# better next to the direction: its sign is tied to it; and without the place along the line (a formula's slides: below
# 0.5 instead of 0.75 mm).
FORESTS = (((0, 1), (0, 1)), ((2,), (2,)), ((0, 1, 3), (3,)), ((0, 1, 4), (4,)))


@dataclass(frozen=True)
class TreesConfig:
    """trees: in each of the forests. least_leaf: windows that a leaf averages at least. More trees make the graph
    larger (50 on 4200 windows: 19 MB) and hardly better (experiments/LOG.md)."""

    conditioning: Conditioning = field(default_factory=Conditioning)
    training: SharesConfig = field(default_factory=SharesConfig)
    trees: int = 60
    least_leaf: int = 6
    seed: int = 0

    def __post_init__(self) -> None:
        check_ranges(self, trees=(1, 10_000), least_leaf=(1, 1_000_000), seed=SEED)


@dataclass(frozen=True)
class Trees:
    """One forest for each of FORESTS over the columns that they read, in the targets' standard units."""

    columns: np.ndarray
    forests: tuple[ExtraTreesRegressor, ...]
    target: Scale

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the K columns."""
        return OUTPUTS[: len(self.target.mean)]

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K) of features (n, F)."""
        read = np.asarray(features, np.float32)[:, self.columns]
        standard = np.empty((len(read), len(self.outputs)))
        for (grown, taken), forest in zip(_forests(len(self.outputs)), self.forests, strict=True):
            rows = forest.predict(read).reshape(len(read), -1)
            standard[:, taken] = rows[:, [grown.index(k) for k in taken]]
        return self.target.natural(standard)

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """One ensemble node a forest, their columns put back in order. skl2onnx is exact for forests."""
        read = g.columns(features, self.columns)
        parts = []
        forests = _forests(len(self.outputs))
        for (grown, taken), forest in zip(forests, self.forests, strict=True):
            (node,) = _ensemble(forest, len(self.columns)).graph.node
            out = g.name()
            node.input[0], node.output[0], node.name = read, out, out
            g.nodes.append(node)
            parts.append(g.columns(out, np.array([grown.index(k) for k in taken])))
        order = np.argsort(np.concatenate([taken for _, taken in forests]))
        standard = g.columns(g.op("Concat", *parts, axis=1), order)
        return self.target.natural_nodes(g, g.cast(standard, TensorProto.DOUBLE))


def fit_trees(windows: LabelledWindows, config: TreesConfig) -> Trees:
    """Fits to the late windows and to rows between their lines."""
    late, columns, read = read_windows(windows)
    read, goals = with_lines_between(late, read, targets(late))
    scale = Scale.of(goals)
    standard = scale.standard(goals)
    forests = tuple(
        ExtraTreesRegressor(config.trees, min_samples_leaf=config.least_leaf, random_state=config.seed).fit(
            read, standard[:, grown] if len(grown) > 1 else standard[:, grown[0]]
        )
        for grown, _ in _forests(goals.shape[1])
    )
    return Trees(columns, forests, scale)


def _forests(count: int) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Those of FORESTS that the first `count` targets suffice for."""
    return [(grown, taken) for grown, taken in FORESTS if max(grown) < count]


def _ensemble(forest: ExtraTreesRegressor, columns: int) -> onnx.ModelProto:
    kind = FloatTensorType([None, columns])
    return convert_sklearn(
        forest, initial_types=[("x", kind)], target_opset={"": OPSET, "ai.onnx.ml": OPSET_ML}
    )


MODEL = feature_model(TreesConfig, fit_trees)

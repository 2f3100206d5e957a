"""How unlike the calibration a window is: the misfit of a model on features, which answers whatever it is given.

The squared Mahalanobis distance (P. C. Mahalanobis, Proc. Natl. Inst. Sci. India 2, 1936) of the features from their
mean, over their number. Slides of one sensor draw a family of curves (V_x, V_y) with few degrees of freedom; what is no
slide leaves it in directions in which slides hardly differ.
"""

from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from softslide.models.classical.regression import Scale, read_windows
from softslide.models.graph.builder import GraphBuilder
from softslide.pipeline.recordings.windows import LabelledWindows

# Standard deviation added in every direction, of the features' own: what the windows at hand do not show to vary may
# still vary. Between 0.3 and 0.01 it changes little (experiments/LOG.md).
LEAST_DEVIATION = 0.1


@dataclass(frozen=True)
class Misfit:
    """columns: the features read (F',), those of the regressors. axes: (F', F') from standardized features to
    uncorrelated ones of unit variance."""

    columns: np.ndarray
    scale: Scale
    axes: np.ndarray

    @classmethod
    def of(cls, windows: LabelledWindows) -> "Misfit":
        """From the late windows of the slides that are learned from."""
        _, columns, read = read_windows(windows)
        read = read.astype(np.float64)
        scale = Scale.of(read)
        standard = scale.standard(read)
        variance, vectors = np.linalg.eigh(standard.T @ standard / len(standard))
        return cls(columns, scale, vectors / np.sqrt(np.maximum(variance, 0.0) + LEAST_DEVIATION**2))

    def __call__(self, features: np.ndarray) -> np.ndarray:
        """(n,) of features (n, F)."""
        x = self.scale.standard(np.asarray(features, np.float64)[:, self.columns])
        # Row by row: a matrix product's last digits would depend on how many rows it is given.
        return np.array([np.square(row @ self.axes).mean() for row in x])

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """The same in nodes, (B, 1)."""
        x = self.scale.standard_nodes(g, g.cast(g.columns(features, self.columns), TensorProto.DOUBLE))
        z = g.op("MatMul", x, g.constant(self.axes))
        return g.op("Div", g.total(g.op("Mul", z, z), 1, keep=True), g.constant(float(len(self.columns))))

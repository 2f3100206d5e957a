"""What the regressors on the feature vector share: their targets, the columns they read, their units.

Each estimates the same numbers: direction as cosine and sine, log(v sigma_t), offset, and, where recordings say where
the contact was, its place along the line. Energy width sigma_t times speed v is a length that the line alone decides;
the features they read hold no seconds either, so that no speed can leak in.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from softslide.features.vector.energy import energy_width_s
from softslide.features.vector.feature_vector import feature_matrix, feature_names
from softslide.models.classical.augmentation import with_lines_between
from softslide.models.graph.builder import GraphBuilder
from softslide.pipeline.recordings.windows import LabelledWindows

OUTPUTS = ("direction_cos", "direction_sin", "log_speed_width", "offset_mm", "along_mm")

# Share of the stroke before which windows are left out of a fit: slides that differ look alike there, and what is
# learned from them spoils later windows. A Gaussian process's speed error falls from 7.5 to 2.6 % (experiments/LOG.md).
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


def late_windows(windows: LabelledWindows) -> LabelledWindows:
    """The windows that a regressor is fitted to, from EARLIEST on."""
    return windows[windows.stroke_fraction >= EARLIEST]


def float_features(windows: LabelledWindows) -> np.ndarray:
    """Features (n, F) as a graph gets them, rounded to float32."""
    return feature_matrix(windows.volts, windows.elapsed_s).astype(np.float32)


def read_windows(windows: LabelledWindows) -> tuple[LabelledWindows, np.ndarray, np.ndarray]:
    """The late windows, the columns that are read of them (F',), and these features (n, F') in float32."""
    late = late_windows(windows)
    columns = read_columns(late.volts.shape[1] // 3)
    return late, columns, float_features(late)[:, columns]


def targets(windows: LabelledWindows) -> np.ndarray:
    """Targets (n, K) in OUTPUTS order; without the last one if it is not known of all windows."""
    angle = np.deg2rad(windows.direction_deg)
    width = energy_width_s(windows.volts, windows.elapsed_s)
    line = [np.cos(angle), np.sin(angle), np.log(windows.speed_mm_s * width), windows.offset_mm]
    place = [windows.along_mm] if np.isfinite(windows.along_mm).all() else []
    return np.stack(line + place, axis=1)


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

    def standard_nodes(self, g: GraphBuilder, values: str) -> str:
        """`standard` in nodes."""
        return g.op("Div", g.op("Sub", values, g.constant(self.mean)), g.constant(self.deviation))

    def natural_nodes(self, g: GraphBuilder, values: str) -> str:
        """`natural` in nodes."""
        return g.op("Add", g.op("Mul", values, g.constant(self.deviation)), g.constant(self.mean))


@dataclass(frozen=True)
class Units:
    """columns: which features are read (F',). input, target: their scales and the targets'."""

    columns: np.ndarray
    input: Scale
    target: Scale


@dataclass(frozen=True)
class Regressor(ABC):
    """A model from standardized features to standardized targets, with its graph."""

    units: Units

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the K columns: those of OUTPUTS that the targets had."""
        return OUTPUTS[: len(self.units.target.mean)]

    @abstractmethod
    def standard_rows(self, x: np.ndarray) -> np.ndarray:
        """Standardized targets (n, K) of standardized features x (n, F')."""

    @abstractmethod
    def standard_nodes(self, g: GraphBuilder, x: str) -> str:
        """`standard_rows` in nodes of an ONNX graph, in float64."""

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Rows (n, K) in OUTPUTS order of features (n, F)."""
        u = self.units
        x = u.input.standard(np.asarray(features, np.float64)[:, u.columns])
        return u.target.natural(self.standard_rows(x))

    def nodes(self, g: GraphBuilder, features: str) -> str:
        """The same in nodes, in float64: rows (B, K) of features (B, F) float32."""
        u = self.units
        x = u.input.standard_nodes(g, g.cast(g.columns(features, u.columns), TensorProto.DOUBLE))
        return u.target.natural_nodes(g, self.standard_nodes(g, x))


def regression_table(windows: LabelledWindows, between_lines: bool) -> tuple[Units, np.ndarray, np.ndarray]:
    """What to fit to: the units, standardized features (n, F') and standardized targets (n, K).

    between_lines: whether rows between neighbouring lines are added (augmentation.py).
    """
    late, columns, read = read_windows(windows)
    read, goals = read.astype(np.float64), targets(late)
    if between_lines:
        read, goals = with_lines_between(late, read, goals)
    units = Units(columns, Scale.of(read), Scale.of(goals))
    return units, units.input.standard(read), units.target.standard(goals)

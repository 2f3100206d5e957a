"""What every fit returns, whatever the model: a graph, its original, its intervals, and where it may be believed."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import onnx

from features.card import Interval, Validity
from features.stream.conditioning import Conditioning
from pipeline.recordings.windows import LabelledWindows


@dataclass(frozen=True)
class FittedModel:
    """A trained model, ready for export.

    input: "window" or "features" (features/card.py). outputs: columns of the graph's row.
    original: graph inputs by name -> (B, K), what the exported graph must reproduce.
    conditioning: of the signal that it reads.
    summary: figures of the fit, for the record.
    windows: what export is checked on where there are no recordings; None: the recordings' own.
    """

    name: str
    input: str
    outputs: tuple[str, ...]
    graph: onnx.ModelProto
    original: Callable[[dict[str, np.ndarray]], np.ndarray]
    intervals: dict[str, Interval]
    validity: Validity
    conditioning: Conditioning
    summary: dict[str, float] = field(default_factory=dict)
    windows: LabelledWindows | None = None

"""What every model is to the rooms above: an entry with its configuration and its fit, and what the fit returns."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx

from features.card import Interval, Validity
from features.contact.calibration import ContactCalibration
from features.contact.force_map import ForceMap
from features.height import HeightCalibration
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
    contact: what contacts are tracked with; None: the model knows straight slides alone. force: None: it knows none.
    heights: of the skin; None: it knows one alone.
    untimed: how many slides had their onset fitted. left_out: why a recording was not learnt from, by name.
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
    contact: ContactCalibration | None = None
    force: ForceMap | None = None
    heights: HeightCalibration | None = None
    untimed: int = 0
    left_out: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Model:
    """A model's entry in the registry.

    config: its default configuration, a frozen dataclass with a field `conditioning`, the signal path's constants.
    fit: (folder, configuration) -> FittedModel; with from_design (folder, configuration, atlas, calibrate), with alone
    (folder, configuration, atlas, init, progress, calibrate, judge), as `models.registry.fit_model` describes them.
    from_design: whether it can use an atlas of the sensor's design. alone: whether that suffices, so that an atlas is
    solved where none is at hand; such a model can also start from an earlier bundle. several_heights: whether it can
    learn from recordings at several heights of the skin.
    """

    config: Callable[[], Any]
    fit: Callable[..., FittedModel]
    from_design: bool = False
    alone: bool = False
    several_heights: bool = False

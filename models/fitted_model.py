"""What every model is to the rooms above: an entry with its configuration and its fit, and what the fit returns."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx

from softslide.features.card import Interval, Validity
from softslide.features.contact.calibration import ContactCalibration
from softslide.features.contact.force_map import ForceMap
from softslide.features.height import HeightCalibration
from softslide.features.stream.conditioning import Conditioning
from softslide.models.response_map.select import CalibratedMap, calibrated_map
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import LabelledWindows


@dataclass(frozen=True)
class FittedModel:
    """A trained model, ready for export.

    name: the registry's. input: "window" or "features" (features/card.py). outputs: columns of the graph's row.
    original: graph inputs by name -> (B, K), what the exported graph must reproduce.
    conditioning: of the signal that it reads.
    summary: figures of the fit, for the record.
    windows: what export is checked on; None: the recordings' own.
    contact: what contacts are tracked with; None: the model knows straight slides alone. force: None: it knows none.
    heights: of the skin; None: it knows one alone.
    untimed: how many slides had their onset fitted. left_out: why a recording was not learned from, by name.
    """

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
    name: str = ""


@dataclass(frozen=True)
class Given:
    """What a fit is given next to recordings and configuration. A model takes of it what its entry says.

    atlas: of the sensor's design. init: the graph of a bundle of the same model to start from. calibrate: what makes
    the response map. progress: called with the step and the loss, now and then. judge: sees the errors on held-out
    lines after each third of the training but the last, and ends the fit by what it raises.
    """

    atlas: Atlas | None = None
    init: onnx.ModelProto | None = None
    calibrate: Callable[..., CalibratedMap] = calibrated_map
    progress: Callable[[int, float], None] = lambda step, loss: None
    judge: Callable[[int, dict[str, float]], None] | None = None


NOTHING = Given()


@dataclass(frozen=True)
class Model:
    """A model's entry in the registry, which gives it its name.

    config: its default configuration, a frozen dataclass with a field `conditioning`, the signal path's constants.
    uses_design: whether it can use an atlas of the sensor's design. design_suffices: whether it needs no recordings, so
    that an atlas is solved if there is no other; such a model can also start from an earlier bundle. several_heights:
    whether it can learn from recordings at several heights of the skin.
    """

    config: Callable[[], Any]
    fit: Callable[[Folder, Any, Given], FittedModel]
    uses_design: bool = False
    design_suffices: bool = False
    several_heights: bool = False
    name: str = ""

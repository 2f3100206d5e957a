"""What a model on features is fitted to: recorded windows, and windows drawn from the response map.

Recordings run along a few headings and lines; the map that they calibrate knows all of them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from softslide.features.contact.calibration import ContactCalibration
from softslide.features.stream.conditioning import Conditioning
from softslide.models.classical.regression import late_windows
from softslide.models.held_out import line_folds
from softslide.models.response_map.from_atlas import SensorSpread
from softslide.models.response_map.map import ResponseMap
from softslide.models.response_map.select import LEAST_ALONE, CalibratedMap, calibrated_map
from softslide.models.response_map.slide_fit import CalibrationConfig
from softslide.pipeline.atlas.atlas import Atlas
from softslide.pipeline.ranges import POSITIVE, check_ranges
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.windows import LabelledWindows, joined, labelled_windows

RECORDED_FOLDS = 5


@dataclass(frozen=True)
class SharesConfig:
    """recorded_share: of the windows that are fitted to, those of recordings; the others are drawn from the response
    map. 1: recordings alone."""

    recorded_share: float = 0.25

    def __post_init__(self) -> None:
        check_ranges(self, recorded_share=(POSITIVE[0], 1.0))


@dataclass(frozen=True)
class LearnedLines:
    """recorded: n windows of the recordings. whole: what to fit to. folds: what to fit to without some lines, each with
    which of the recorded are those lines' (n,) bool. conditioning: of the signal that all are of. summary: figures of
    the map, where one is drawn from; contact: what that tracks contacts with. untimed: how many slides had their onset
    fitted. left_out: why a recording gives no window, by name."""

    recorded: LabelledWindows
    whole: LabelledWindows
    folds: list[tuple[LabelledWindows, np.ndarray]]
    conditioning: Conditioning
    summary: dict[str, float] = field(default_factory=dict)
    untimed: int = 0
    left_out: dict[str, str] = field(default_factory=dict)
    contact: ContactCalibration | None = None


def learned_windows(
    folder: Folder,
    conditioning: Conditioning,
    shares: SharesConfig,
    atlas: Atlas | None,
    calibrate: Callable[..., CalibratedMap] = calibrated_map,
) -> LearnedLines:
    """The recorded windows and as many drawn ones as the shares say.

    calibrate: in place of `calibrated_map`.

    Recordings alone of sensors of other kinds than accelerometers, whose drawn windows were not tried, and of fewer
    than LEAST_ALONE without an atlas, which calibrate no map.

    Raises:
        InputError: none of the recordings can be used.
    """
    drawn = folder.sensor.measures_gravity and (atlas is not None or len(folder) >= LEAST_ALONE)
    if shares.recorded_share == 1.0 or not drawn:
        return _recorded_alone(folder, conditioning)
    found = calibrate(folder, atlas, conditioning, CalibrationConfig(), SensorSpread())
    used = ~found.folder.manifest.index.isin(found.left_out)
    read = replace(found.folder, manifest=found.folder.manifest[used])
    recorded = labelled_windows(read, found.conditioning)

    def with_drawn(rows: LabelledWindows, response: ResponseMap) -> LabelledWindows:
        count = round(len(late_windows(rows)) * (1.0 / shares.recorded_share - 1.0))
        if not count:
            return rows
        return joined([rows, drawn_windows(response, found.conditioning.block_s, count)])

    unseen = [(response, np.isin(recorded.recording, names)) for response, names in found.held_out]
    folds = [(with_drawn(recorded[~mask], response), mask) for response, mask in unseen]
    return LearnedLines(
        recorded,
        with_drawn(recorded, found.response),
        folds,
        found.conditioning,
        found.summary,
        found.untimed,
        found.left_out | _without_window(read, recorded),
        found.contact(atlas),
    )


def _recorded_alone(folder: Folder, conditioning: Conditioning) -> LearnedLines:
    windows = labelled_windows(folder, conditioning)
    fold = line_folds(windows.direction_deg, windows.offset_mm, RECORDED_FOLDS)
    folds = [(windows[fold != k], fold == k) for k in range(RECORDED_FOLDS)]
    return LearnedLines(windows, windows, folds, conditioning, left_out=_without_window(folder, windows))


def _without_window(folder: Folder, windows: LabelledWindows) -> dict[str, str]:
    return {
        str(name): "no output reaches the trigger"
        for name in folder.manifest.index
        if name not in windows.recording
    }


def drawn_windows(response: ResponseMap, block_s: float, count: int) -> LabelledWindows:
    """So many late windows of slides over the whole skin, in any direction; seeded.

    They begin beyond the rim and are seen under way, as recorded slides are.
    """
    # With torch, which takes seconds to import, and which other models on features do without.
    import torch

    from softslide.models.cnn.training_windows import SynthesisConfig, WindowSource

    source = WindowSource(response, block_s, SynthesisConfig(midway=0.0, paused=0.0, dead=0.0))
    generator = torch.Generator().manual_seed(0)
    parts: list[LabelledWindows] = []
    while not parts or sum(len(part) for part in parts) < count:
        parts.append(late_windows(source.draw(count, generator).labelled()))
    return joined(parts)[:count]

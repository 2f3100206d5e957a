"""Windows with their labels: what a model is fitted to, read from a folder as the runtime would see it.

The labels choose the moments at which a recording's stream is read and become the targets. Neither they nor
those moments enter a window: its volts and its length come from the stream alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning, block_means, blocks_in
from softslide.features.stream.tracker import track
from softslide.pipeline.recordings.folder import Folder
from softslide.pipeline.recordings.manifest import LABELS

STROKE_FRACTIONS = tuple(k / 10 for k in range(1, 11))
_TARGETS = ("direction_deg", "speed_mm_s", "offset_mm", "depth_mm")


@dataclass(frozen=True)
class LabelledWindows:
    """n windows of one sensor and what was done in each; a label that the lab did not give is NaN.

    volts: (n, C, 64) float32 V; elapsed_s: (n,) s since the trigger. These two are all that a model reads.
    direction_deg, speed_mm_s, offset_mm, depth_mm: (n,), as in the manifest.
    along_mm: (n,), position of the contact along its line, from the foot of the perpendicular from the
        sensor's reference point, positive in the sense of motion.
    stroke_fraction: (n,), share of the motion seen; recording, split: (n,) names.
    """

    volts: np.ndarray
    elapsed_s: np.ndarray
    direction_deg: np.ndarray
    speed_mm_s: np.ndarray
    offset_mm: np.ndarray
    depth_mm: np.ndarray
    along_mm: np.ndarray
    stroke_fraction: np.ndarray
    recording: np.ndarray
    split: np.ndarray

    def __len__(self) -> int:
        return len(self.elapsed_s)

    def __getitem__(self, rows: np.ndarray | slice) -> "LabelledWindows":
        """The windows that a mask, an index array or a slice picks."""
        return LabelledWindows(**{name: values[rows] for name, values in vars(self).items()})


def joined(parts: Sequence[LabelledWindows]) -> LabelledWindows:
    """The windows of all parts, of one sensor, in their order."""
    columns = {name: [getattr(part, name) for part in parts] for name in vars(parts[0])}
    return LabelledWindows(**{name: np.concatenate(values) for name, values in columns.items()})


def labelled_windows(
    folder: Folder,
    conditioning: Conditioning | None = None,
    fractions: Sequence[float] = STROKE_FRACTIONS,
) -> LabelledWindows:
    """Every recording's window at each fraction of its stroke; fractions before the trigger give none.

    A recording whose moments of motion are unknown is read once, at its end, as fraction 1.

    Raises:
        InputError: a slide is unreadable, or no slide of the folder was triggered.
    """
    conditioning = conditioning or Conditioning()
    rows = [
        row for name in folder.manifest.index for row in _windows_of(folder, name, conditioning, fractions)
    ]
    if not rows:
        raise InputError(
            f"{folder.root}: no slide tilts a board by {conditioning.trigger_v:g} V; check the wiring and the gain"
        )
    arrays = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    arrays["volts"] = arrays["volts"].astype(np.float32, copy=False)
    return LabelledWindows(**arrays)


def _windows_of(
    folder: Folder, name: str, conditioning: Conditioning, fractions: Sequence[float]
) -> list[dict[str, object]]:
    recording = folder.load(name)
    row = folder.manifest.loc[[name], list(LABELS)].to_numpy(float)[0]
    labels = dict(zip(LABELS, row.tolist(), strict=True))
    rate = folder.sensor.sample_rate_hz
    blocks = block_means(recording.volts, conditioning, rate)
    start_s, end_s = labels["motion_start_s"], labels["motion_end_s"]
    known = bool(np.isfinite(start_s) and np.isfinite(end_s))
    stroke = np.sort(np.asarray(fractions, float)) if known else np.ones(1)
    read_s = start_s + stroke * (end_s - start_s) if known else recording.time_s[-1:]
    seen = np.round((read_s - recording.time_s[0]) * rate)
    read_at = blocks_in(seen, conditioning.block_samples(rate))
    windows = track(blocks, conditioning, np.minimum(read_at, len(blocks)))
    # s = cos(a) (x - x_ref) + sin(a) (y - y_ref) at the start of the motion.
    angle, (x_ref, y_ref) = np.deg2rad(labels["direction_deg"]), folder.sensor.reference_mm
    first = np.cos(angle) * (labels["start_x_mm"] - x_ref) + np.sin(angle) * (labels["start_y_mm"] - y_ref)
    return [
        {
            "volts": window.volts,
            "elapsed_s": window.elapsed_s,
            **{target: labels[target] for target in _TARGETS},
            "along_mm": float(first) + fraction * labels["travel_mm"],
            "stroke_fraction": float(fraction),
            "recording": name,
            "split": str(folder.manifest.at[name, "split"]),
        }
        for fraction, window in zip(stroke, windows, strict=True)
        if window is not None
    ]

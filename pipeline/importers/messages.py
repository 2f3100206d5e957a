"""Messages on an import: signs flipped and why, clocks resampled, moments of motion moved."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from softslide.pipeline.importers.import_map import Map

# Mean agreement below which the labelled slides show an output to be inverted; correctly wired ones reach +0.9.
INVERTED = -0.4


def inverted(entries: Sequence[dict[str, Any]], mapping: Map) -> tuple[dict[int, float], list[str]]:
    """Outputs to flip, as channel -> the volts to mirror them at, and why."""
    parts, known_signs = mapping.sensor.accelerometers, [each["agreement"] for each in entries]
    cosines = np.array([signs for signs in known_signs if signs], dtype=float).reshape(-1, len(parts), 3, 2)
    flips: dict[int, float] = {}
    notes: list[str] = []
    for k, part in enumerate(parts):
        for i, axis in enumerate("xy" if part.measures_gravity else ""):
            known = cosines[:, k, i, i][~np.isnan(cosines[:, k, i, i])]
            if len(known) < 3 or known.mean() > INVERTED:
                continue
            why = (
                f"{part.name}_v{axis}: inverted in {(known < 0).sum()} of {len(known)} labelled slides "
                f"(agreement with the article's zones {known.mean():+.2f}; inverted below {INVERTED:+.2f})"
            )
            if mapping.signs == "zones":
                flips[3 * k + i] = part.zero_g_v
                notes.append(f"flipped {why}")
            else:
                notes.append(f'not flipped {why}; set signs = "zones" to flip it')
    return flips, notes


def clock_notes(entries: Sequence[dict[str, Any]], mapping: Map) -> list[str]:
    notes = []
    widest = max(entries, key=lambda entry: entry["largest_gap_s"])
    resampled = sum(entry["resampled"] for entry in entries)
    if resampled:
        notes.append(
            f"resampled {resampled} of {len(entries)} recordings onto {mapping.sensor.sample_rate_hz:g} Hz; "
            f"largest gap {widest['largest_gap_s']:.6g} s, in {widest['recording']}"
        )
    shifts = np.array([entry["shift_s"] for entry in entries if entry["shift_s"] is not None])
    if len(shifts):
        notes.append(
            f"aligned {len(shifts)} of {len(entries)} recordings on the onset: the motion moved by "
            f"{np.median(shifts):+.3f} s (median), {shifts.min():+.3f} to {shifts.max():+.3f} s"
        )
    return notes


def mounting_notes(mapping: Map) -> list[str]:
    notes = []
    for name, board in mapping.boards.items():
        if board.flip:
            notes.append(f"flipped {', '.join(f'{name}_v{axis}' for axis in board.flip)}: the map says so")
        if board.turn_deg:
            notes.append(f"turned {name} by {board.turn_deg:g} degrees: the map says so")
        if board.calibration:
            notes.append(f"calibrated {name} with {board.calibration}")
    return notes

"""Contact zones around an accelerometer, from the signs of its outputs (article, 2.3).

A contact tilts the accelerometer's board towards itself, so that the signs of the subtracted V_x and V_y show the
quadrant of the contact: zone 1 (-, -), zone 2 (+, -), zone 3 (-, +), zone 4 (+, +).
"""

import numpy as np

# Share of the window's largest |V| below which a sign is ignored: at the least valid output, 8 mV, it is 0.8 mV,
# above the 0.5 mV of noise in a bin of 0.1 s.
DEAD_BAND = 0.1


def signs(tilt: np.ndarray) -> np.ndarray:
    """Signs (..., 2, N) of V_x and V_y in every bin: -1, +1, or 0 before an output first leaves the dead band.

    tilt: (..., 2, N) V. Within the dead band, +-DEAD_BAND of the largest |V| of the two, the last sign is kept: noise
    of an output near zero changes no zone.
    """
    band = DEAD_BAND * np.abs(tilt).max(axis=(-2, -1), keepdims=True)
    outside = np.abs(tilt) > band
    last = np.maximum.accumulate(np.where(outside, np.arange(tilt.shape[-1]), -1), axis=-1)
    held = np.take_along_axis(np.sign(tilt), np.maximum(last, 0), axis=-1)
    return np.where(last >= 0, held, 0.0)


def first_and_last(sign: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First nonzero sign and last sign, (...) each, of signs (..., N); 0: none so far."""
    first = np.argmax(sign != 0, axis=-1)
    return np.take_along_axis(sign, first[..., None], axis=-1)[..., 0], sign[..., -1]


def zone(sign: np.ndarray) -> np.ndarray:
    """Zone 1 to 4 in every bin (..., N) from signs (..., 2, N); 0 while a sign is missing."""
    x, y = sign[..., 0, :], sign[..., 1, :]
    return np.where((x == 0) | (y == 0), 0.0, 1.0 + (x > 0) + 2.0 * (y > 0))


def zones_in_order(zones: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The first `count` zones entered and when: both (..., count), of zones (..., N).

    The moment is a fraction of the window. Zones never entered are 0, at moment 1.
    """
    bins = zones.shape[-1]
    before = np.concatenate([np.zeros_like(zones[..., :1]), zones[..., :-1]], axis=-1)
    # Zone 0 occurs only before the first zone, so that every change of zone is an entry.
    rank = np.cumsum(zones != before, axis=-1)
    entered = rank[..., None, :] == np.arange(1, count + 1)[:, None]
    happened = entered.any(axis=-1)
    at = np.argmax(entered, axis=-1)
    return (
        np.where(happened, np.take_along_axis(zones, at, axis=-1), 0.0),
        np.where(happened, at / bins, 1.0),
    )

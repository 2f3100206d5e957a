"""Where a contact may be while several hypotheses about it live: the few likeliest places, with their weights."""

from typing import NamedTuple

import numpy as np

# What a person takes in at a glance; the rest of the weight, if any, is spread over places less likely than these.
MOST_PLACES = 5
LEAST_WEIGHT = 0.02


class Place(NamedTuple):
    """Hypotheses of one place: the mean of theirs (mm, from the chamber's centre) and their share of the
    weight of all."""

    x_mm: float
    y_mm: float
    weight: float


def likeliest_places(place_mm: np.ndarray, weight: np.ndarray, near_mm: float) -> tuple[Place, ...]:
    """The likeliest first; empty where one place alone is left.

    place_mm: (N, 2). weight: (N,), the sum is 1. near_mm: hypotheses within it of a likelier one are of its place.
    """
    left = weight.copy()
    found: list[Place] = []
    while len(found) < MOST_PLACES:
        best = int(left.argmax())
        near = (np.hypot(*(place_mm - place_mm[best]).T) < near_mm) & (left > 0.0)
        share = float(left[near].sum())
        if share < LEAST_WEIGHT:
            break
        x_mm, y_mm = (left[near] @ place_mm[near] / share).tolist()
        found.append(Place(x_mm, y_mm, share))
        left[near] = 0.0
    found.sort(key=lambda place: -place.weight)
    return tuple(found) if len(found) > 1 else ()

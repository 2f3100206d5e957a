"""Where a contact may be while several hypotheses live: the likeliest places, from a bank and along a slide."""

import numpy as np
import pytest
from tracked_map import followed, line, noisy_map

from softslide.features.contact.places import LEAST_WEIGHT, MOST_PLACES, likeliest_places

NEAR_MM = 2.5


def bank(seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    weight = random.exponential(size=60) ** 3
    return random.uniform(-25, 25, (60, 2)), weight / weight.sum()


@pytest.mark.parametrize("seed", range(9))
def test_places_lie_apart_and_share_the_weight(seed: int) -> None:
    place_mm, weight = bank(seed)
    found = likeliest_places(place_mm, weight, NEAR_MM)
    shares = [place.weight for place in found]
    assert shares == sorted(shares, reverse=True)
    assert len(found) <= MOST_PLACES
    assert min(shares) >= LEAST_WEIGHT
    assert sum(shares) <= 1.0 + 1e-12
    best = place_mm[weight.argmax()]
    assert min(np.hypot(p.x_mm - best[0], p.y_mm - best[1]) for p in found) < NEAR_MM


def test_what_lies_together_is_one_place_of_all_its_weight_and_is_not_listed_alone() -> None:
    place_mm = np.array([[0.0, 0.0], [1.0, 0.0], [10.0, 5.0], [20.0, 0.0]])
    first, second = likeliest_places(place_mm, np.array([0.3, 0.3, 0.395, 0.005]), NEAR_MM)
    assert first == pytest.approx((0.5, 0.0, 0.6))
    assert second == pytest.approx((10.0, 5.0, 0.395))
    assert likeliest_places(place_mm[[0, 1, 3]], np.array([0.6, 0.39, 0.01]), NEAR_MM) == ()


def test_a_slide_begins_at_several_places_the_true_one_among_them_and_ends_at_one() -> None:
    response = noisy_map()
    path_mm = line(3.0)
    tracks = followed(response, path_mm)
    open_ = [n for n, track in enumerate(tracks) if track is not None and track.places]
    assert open_
    places = [(path_mm[n], tracks[n].places) for n in open_]
    near = [min(np.hypot(p.x_mm - x, p.y_mm - y) for p in found) for (x, y), found in places]
    assert np.median(near) < 4.0
    inside = [n for n, (x, _) in enumerate(path_mm) if abs(x) < 10]
    assert not [n for n in inside[len(inside) // 2 :] if tracks[n] is None or tracks[n].places]

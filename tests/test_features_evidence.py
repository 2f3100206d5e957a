"""What decides between hypotheses: evidence of all channels that are left, and no weight without a covariance."""

import numpy as np
import pytest
from tracked_map import BLOCK_S, TWO_BOARDS, bank_of, line, noisy_map, touched, tracker, volts_along

from softslide.features.contact.hypotheses import update
from softslide.features.contact.manoeuvres import Manoeuvres, branched
from softslide.features.contact.track import Track
from softslide.features.contact.tracker import ContactTracker, StraightFit

ONE, TWO = noisy_map(), noisy_map(places=TWO_BOARDS)
FIRST_ALONE = np.array([True, True, False, False])


def followed(tracked: ContactTracker, volts: np.ndarray, usable: np.ndarray) -> list[Track]:
    tracks = [tracked.push(v, bool(t), usable) for v, t in zip(volts, touched(volts[:, :2]), strict=True)]
    return [track for track in tracks if track is not None]


def bumps(seed: int) -> np.ndarray:
    """Blocks (m, 2) V of a bump in each channel, which no contact makes, with noise of 1 mV."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, 12.0, BLOCK_S)[:, None]
    height, width = random.uniform(0.02, 0.1, 2) * random.choice([-1.0, 1.0], 2), random.uniform(0.8, 2.0, 2)
    shape = height * np.exp(-0.5 * ((time - random.uniform(4.5, 7.5, 2)) / width) ** 2)
    return shape + 1e-3 * random.standard_normal(shape.shape)


def test_bumps_earn_no_evidence_while_an_accelerometer_is_out() -> None:
    """Of the channels that are left; no evidence at all would let them pass."""
    ends = []
    for seed in range(4):
        shown = bumps(seed)
        volts = np.concatenate([shown, np.full_like(shown, 0.3)], axis=1)
        tracks = followed(tracker(TWO), volts, FIRST_ALONE)
        assert tracks[-1].evidence.channels == 2
        ends.append(tracks[-1].evidence.log_odds)
    assert min(ends) < -1.0
    assert all(ends)


def test_a_slide_earns_evidence_while_an_accelerometer_is_out() -> None:
    volts = volts_along(TWO, line(4.0))
    volts[:, 2:] = 0.3
    assert max(track.evidence.log_odds for track in followed(tracker(TWO), volts, FIRST_ALONE)) > 5.0


@pytest.mark.parametrize("shown_v", [0.3, -1.7, np.nan])
def test_what_a_dead_channel_shows_makes_no_difference(shown_v: float) -> None:
    """A wire at 0 V shows the static output with its sign turned, more than any contact."""
    volts, channels = volts_along(TWO, line(4.0)), np.array([True, True, False, True])
    volts[:, 2] = 0.0
    without = followed(tracker(TWO), volts, channels)
    volts[:, 2] = shown_v
    tracks = followed(tracker(TWO), volts, channels)
    assert len(tracks) == len(without)
    for track, other in zip(tracks, without, strict=True):
        assert (track.mean == other.mean).all()
        assert track.evidence == other.evidence


def test_children_begin_with_no_way() -> None:
    """A way counts for the manoeuvres of one branching, once."""
    whole = bank_of(ONE, count=3)
    whole.way_mm[:] = 3.0
    bank = branched(whole, 3, 5.0, 0.02, Manoeuvres())
    assert len(bank) > 3
    assert not bank.way_mm.any()


def test_an_indefinite_covariance_never_wins() -> None:
    """It would predict with a determinant of next to nothing."""
    bank = bank_of(ONE, count=3)
    bank.covariance[1] = -1e3 * np.eye(bank.state.shape[1])
    with np.errstate(invalid="raise"):
        update(bank, np.array([0.01, 0.01]), np.full(2, 1e-6), tracker(ONE)._surface, BLOCK_S)
    assert not bank.sound[1]
    assert bank.sound[[0, 2]].all()
    assert bank.log_weight[1] == -np.inf


@pytest.mark.parametrize("lost", [True, False], ids=["lost track, right fit", "right track, wrong fit"])
def test_likelihood_decides_whether_a_fit_leads_that_is_offered(lost: bool) -> None:
    path = line(4.0)
    volts, tracked = volts_along(ONE, path), tracker(ONE)
    half = len(volts) // 2
    followed(tracked, volts[:half], FIRST_ALONE[:2])
    assert tracked._bank is not None
    x_mm, y_mm = path[half - 1]
    heading = 0.0
    if lost:
        tracked._bank.state[:, 1] += 5.0
    else:
        y_mm, heading = y_mm + 6.0, 1.0
    tracked.offer(StraightFit(x_mm, y_mm, heading, 4.0, 0.0, 0.1, 0.02, 0.02, 0.02, 20.0))
    last = followed(tracked, volts[half : half + 10], FIRST_ALONE[:2])[-1]
    assert last.mean[:2] == pytest.approx(path[half + 9], abs=0.5)
    assert last.mean[2:] == pytest.approx([4.0, 0.0], abs=0.8)

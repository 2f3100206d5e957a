"""What an accelerometer shows while it is not yet known to be faulty is taken back."""

import numpy as np
import pytest
from tracked_map import line, noisy_map, touched, tracker, volts_along

from softslide.features.contact.replay import ReplayingTracker
from softslide.features.contact.track import Track
from softslide.features.stream.faults import FROZEN_BLOCKS

TWO_BOARDS = noisy_map(places=((-4.0, 0.0), (4.0, 0.0)))
FIRST_ALONE = np.array([True, True, False, False])
SPEED_MM_S = 6.0
CLEAN = volts_along(TWO_BOARDS, line(SPEED_MM_S, half_mm=27.0))


def replaying() -> ReplayingTracker:
    return ReplayingTracker(tracker(TWO_BOARDS))


def slide_that_loses_a_board(failed: int) -> np.ndarray:
    """Blocks (m, 4) V along a line; from block `failed` on the second board's output stands 0.4 V off."""
    volts = CLEAN.copy()
    volts[failed:, 2:] = -0.4
    return volts


def tracks(tracked, volts: np.ndarray, found: int) -> list[Track | None]:
    """The second board is left out from block `found` on."""
    usable = [np.ones(4, dtype=bool)] * found + [FIRST_ALONE] * (len(volts) - found)
    blocks = zip(volts, touched(volts[:, :2]), usable, strict=True)
    return [tracked.push(block, bool(touch), use) for block, touch, use in blocks]


def test_without_replay_the_track_is_lost() -> None:
    """The same fault for a tracker that goes on from where the fault led it: what the replay is for."""
    failed = 163
    found = failed + FROZEN_BLOCKS
    lost = tracks(tracker(TWO_BOARDS), slide_that_loses_a_board(failed), found)[found]
    assert lost is not None
    assert np.abs(lost.mean[2:] - [SPEED_MM_S, 0.0]).max() > 3.0


@pytest.mark.parametrize("failed", [4 * FROZEN_BLOCKS + 7, 163, 240])
def test_after_a_fault_it_is_a_tracker_that_never_read_the_board_since_the_copy(failed: int) -> None:
    """Copies are made after each FROZEN_BLOCKS; the last but one before the fault was found is gone back to."""
    found = failed + FROZEN_BLOCKS
    volts = slide_that_loses_a_board(failed)
    copied = (found - 1) // FROZEN_BLOCKS * FROZEN_BLOCKS - FROZEN_BLOCKS
    assert found - copied >= FROZEN_BLOCKS
    expect_same(tracks(replaying(), volts, found)[found:], tracks(tracker(TWO_BOARDS), volts, copied)[found:])


def test_without_a_fault_it_is_the_tracker_that_it_holds() -> None:
    never = len(CLEAN)
    expect_same(tracks(replaying(), CLEAN, never), tracks(tracker(TWO_BOARDS), CLEAN, never))


def expect_same(found: list[Track | None], wanted: list[Track | None]) -> None:
    for mine, its in zip(found, wanted, strict=True):
        assert (mine is None) == (its is None)
        if mine is not None and its is not None:
            assert np.array_equal(mine.mean, its.mean)


def test_a_stream_begun_anew_goes_back_to_nothing_before() -> None:
    """A fault right after a reset must not bring back the contact of before it."""
    tracked = replaying()
    assert tracks(tracked, CLEAN[:200], 200)[-1] is not None
    tracked.reset()
    tracked.push(np.zeros(4), False, np.ones(4, dtype=bool))
    assert tracked.push(np.zeros(4), False, FIRST_ALONE) is None

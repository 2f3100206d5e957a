"""Estimates of a recording in which each contact is known to its end: each moment's from the whole contact."""

from collections.abc import Iterator

import numpy as np

from softslide.features.angles import touch_channels
from softslide.features.card import Card
from softslide.features.contact.track import ContactEvidence, Track
from softslide.features.errors import InputError
from softslide.features.estimate import Estimate, Reason
from softslide.features.stream.conditioning import ONSETS, LagUndone
from softslide.features.stream.tracker import SlideState
from softslide.features.track_estimate import TOUCH_LIMITS, judged
from softslide.features.whole_contact.first_places import Measured
from softslide.features.whole_contact.whole_path import PathConfig, WholePath, whole_path
from softslide.serve.localizer import Localizer

# A contact comes down and is lifted within a block each, which then show a part of it.
PARTIAL_BLOCKS = 1
# A long contact is fitted in pieces, since the work grows with the third power of its way: 8 s each, with 2 s on either
# side, so that what is reported hardly depends on what lies beyond.
PIECE_BLOCKS, BESIDE_BLOCKS = 400, 100
# What makes a block's samples doubtful, whatever comes after them.
OF_THE_SIGNAL = (Reason.DEAD_CHANNEL, Reason.DRIFT)


def has_whole_contacts(card: Card) -> bool:
    """Whether `whole_contacts` applies: contacts come down anywhere, on a map of recordings alone.

    Contacts over a chamber's rim also rest, stop and turn back, which the curves of `whole_path` do not.
    """
    return card.contact is not None and card.conditioning.onset == ONSETS[1]


def whole_contacts(localizer: Localizer, volts: np.ndarray) -> list[Estimate]:
    """The estimates of a recording (n, C) V from a fresh start, one a block.

    A block in which something touches has the path of its whole contact, from what came before and after it. Others
    have what `Localizer.push` gives, and so have contacts that are too short for a path, or known too little of.

    Raises:
        InputError: the bundle is for other contacts, or as `Localizer.push`.
    """
    card = localizer.card
    if not has_whole_contacts(card):
        raise InputError(
            f"the bundle of {card.sensor['name']} knows no whole contacts: these are for cnn of skins that are touched "
            "anywhere, as those of magnetometers; leave the option out"
        )
    touch = touch_channels(len(card.channels), card.conditioning.touch_axes)
    lag = LagUndone(card.conditioning, len(touch))
    estimates: list[Estimate] = []
    blocks = []
    localizer.reset()
    for estimate in localizer.each(volts):
        estimates.append(estimate)
        subtracted = card.conditioning.scale * localizer.subtracted[touch]
        if localizer.measured and np.isfinite(subtracted).all():
            blocks.append(lag.push(subtracted))
        else:
            blocks.append(np.full(len(touch), np.nan))
    volts_of = np.array(blocks)
    for contact in _contacts(estimates, volts_of, card.conditioning.release_v):
        for seen, reported in _pieces(contact):
            path = _path(card, volts_of[seen])
            if path is not None:
                part = slice(reported.start - seen.start, reported.stop - seen.start)
                estimates[reported] = _reported(card, path, part, estimates[reported])
    return estimates


def _contacts(estimates: list[Estimate], blocks: np.ndarray, release_v: float) -> Iterator[slice]:
    """Whole contacts: the blocks that show all of each."""
    sliding = np.array([False, *(e.state is SlideState.SLIDE for e in estimates), False])
    for begin, end in np.flatnonzero(np.diff(sliding.astype(int))).reshape(-1, 2):
        lifted = np.flatnonzero(np.abs(blocks[begin:end]).max(axis=1) < release_v)
        last = begin + lifted[0] - PARTIAL_BLOCKS if len(lifted) else end
        yield slice(begin + PARTIAL_BLOCKS, last)


def _pieces(contact: slice) -> Iterator[tuple[slice, slice]]:
    """Pieces of a contact, each with the blocks that it is fitted to and those that it reports."""
    for begin in range(contact.start, contact.stop, PIECE_BLOCKS):
        end = min(begin + PIECE_BLOCKS, contact.stop)
        yield (
            slice(max(begin - BESIDE_BLOCKS, contact.start), min(end + BESIDE_BLOCKS, contact.stop)),
            slice(begin, end),
        )


def _path(card: Card, volts: np.ndarray) -> WholePath | None:
    """The path of one contact (m, T) V."""
    contact = card.contact
    assert contact is not None
    measured = Measured(
        volts=volts,
        variance=np.full(volts.shape[1], contact.floor_v**2),
        block_s=card.conditioning.block_s,
        gain_sd=contact.gain_sd,
        half_mm=contact.chamber_half_mm,
    )
    return whole_path(measured, contact.surface(), PathConfig())


def _reported(card: Card, path: WholePath, part: slice, live: list[Estimate]) -> list[Estimate]:
    """The estimates of a part of a path, in place of the live ones."""
    contact = card.contact
    assert contact is not None
    accelerometers = len(card.channels) // 3
    reported = []
    for mean, covariance, at in zip(path.mean[part], path.covariance[part], live, strict=True):
        if at.reason in OF_THE_SIGNAL:
            reported.append(at)
            continue
        track = Track(
            mean=mean,
            covariance=covariance,
            certain=1.0,
            misfit=path.misfit,
            partial=0.0,
            gain=path.gain,
            depth_mm=0.0,
            depth_sd_mm=contact.depth_sd_mm,
            hypotheses=1,
            way_mm=path.way_mm,
            evidence=ContactEvidence(channels=len(contact.noise_v)),
        )
        estimate = judged(track, at.time_s, at.state, card.reference_mm, contact.depth_mm, TOUCH_LIMITS)
        reported.append(
            estimate._replace(
                accelerometers=accelerometers,
                zero_shift_v=at.zero_shift_v,
                gain=at.gain,
                turn_deg=at.turn_deg,
                skin_height_mm=at.skin_height_mm,
            )
        )
    return reported

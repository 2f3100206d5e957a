"""The tracker of contacts that a model card describes."""

import math
from dataclasses import replace

import numpy as np

from softslide.features.card import Card
from softslide.features.contact.replay import ReplayingTracker
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.touch_down import TouchDownConfig, TouchDownTracker
from softslide.features.contact.tracker import STEP_BLOCKS, ContactTracker, TrackingConfig
from softslide.features.stream.conditioning import ONSETS

AnyTracker = ContactTracker | TouchDownTracker | ReplayingTracker


def contact_tracker(
    card: Card,
    noise_gain: float,
    height_mm: float,
    config: TrackingConfig | None = None,
    replays: bool = True,
    lag_blocks: int = 0,
) -> AnyTracker | None:
    """The tracker that a card describes; None for a bundle that knows straight slides alone.

    height_mm: of the skin, for a card over heights; NaN: the card's. config: of contacts over the rim, but for the
    card's depth; None: TrackingConfig(). replays: whether one of several accelerometers goes back where one has failed.
    lag_blocks: how far back `past` reads.
    """
    contact = card.contact
    if contact is None:
        return None
    surface = response_surface(card, height_mm)
    half_mm = (contact.chamber_mm[0] / 2, contact.chamber_mm[1] / 2)
    tracker: ContactTracker | TouchDownTracker
    if card.conditioning.onset == ONSETS[1]:
        tracker = TouchDownTracker(
            surface=surface,
            half_mm=half_mm,
            block_s=card.conditioning.block_s,
            noise_v=noise_gain * np.array(contact.noise_v),
            floor_v=contact.floor_v,
            gain_sd=contact.gain_sd,
            trigger_v=card.conditioning.trigger_v,
            release_v=card.conditioning.release_v,
            config=TouchDownConfig(remembered=lag_blocks + 1 if lag_blocks else 0),
        )
    else:
        tracker = ContactTracker(
            surface=surface,
            half_mm=half_mm,
            block_s=card.conditioning.block_s,
            noise_v=noise_gain * np.array(contact.noise_v),
            floor_v=contact.floor_v,
            gain_sd=contact.gain_sd,
            trigger_v=card.conditioning.trigger_v,
            release_v=card.conditioning.release_v,
            config=replace(
                config or TrackingConfig(),
                depth_sd_mm=contact.depth_sd_mm,
                remembered=math.ceil(lag_blocks / STEP_BLOCKS) + 1 if lag_blocks else 0,
            ),
            inflation_v_per_mm=contact.inflation_v_per_mm,
            floor_share=contact.floor_share,
        )
    # Where the only accelerometer fails, nothing is left to track with.
    return ReplayingTracker(tracker) if replays and len(card.channels) > 3 else tracker


def response_surface(card: Card, height_mm: float = math.nan) -> ResponseSurface:
    """The calibrated response of a card that has one. height_mm: as in `contact_tracker`."""
    contact = card.contact
    assert contact is not None
    splines = contact.splines()
    if card.heights is not None and not math.isnan(height_mm):
        splines[0] += (height_mm - card.heights.height_mm) * card.heights.splines()
    return ResponseSurface(splines, contact.half_mm, contact.spacing_mm)

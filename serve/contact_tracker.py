"""The tracker of contacts that a model card describes."""

import math

from softslide.features.card import Card
from softslide.features.contact.replay import ReplayingTracker
from softslide.features.contact.response_surface import ResponseSurface
from softslide.features.contact.tracker import ContactTracker
from softslide.features.contact.tracking_config import TOUCH_DOWN, TrackingConfig
from softslide.features.stream.conditioning import ONSETS

AnyTracker = ContactTracker | ReplayingTracker


def contact_tracker(
    card: Card,
    height_mm: float,
    config: TrackingConfig | None = None,
    replays: bool = True,
    lag_blocks: int = 0,
) -> AnyTracker | None:
    """The tracker that a card describes; None for a bundle that knows straight slides alone.

    height_mm: of the skin, for a card over heights; NaN: the card's. config: None: by how contacts come on the card's
    skin. replays: whether one of several accelerometers goes back where one has failed. lag_blocks: how far back `past`
    reads.
    """
    if card.contact is None:
        return None
    if config is None:
        config = TOUCH_DOWN if card.conditioning.onset == ONSETS[1] else TrackingConfig()
    surface = response_surface(card, height_mm)
    tracker = ContactTracker(surface, card.contact, card.conditioning, config, lag_blocks)
    # Where the only accelerometer fails, nothing is left to track with.
    return ReplayingTracker(tracker) if replays and len(card.channels) > 3 else tracker


def response_surface(card: Card, height_mm: float = math.nan) -> ResponseSurface:
    """The calibrated response of a card that has one. height_mm: as in `contact_tracker`."""
    contact = card.contact
    assert contact is not None
    splines = contact.splines()
    if card.heights is not None and not math.isnan(height_mm):
        splines[0] += (height_mm - card.heights.height_mm) * card.heights.splines(len(contact.noise_v))
    return ResponseSurface(splines, contact.half_mm, contact.spacing_mm)

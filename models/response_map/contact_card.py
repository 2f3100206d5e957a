"""The calibrated response map as the model card's section `contact`, and back."""

from typing import Any

import numpy as np

from features.card import Card
from features.contact.calibration import ContactCalibration, encoded
from features.stream.conditioning import ONSETS
from models.response_map.map import PARTS, ResponseMap
from models.response_map.static_scatter import StaticScatter


def contact_calibration(
    response: ResponseMap, inflation_v_per_mm: tuple[float, ...] = (), static: StaticScatter | None = None
) -> ContactCalibration:
    """What a device needs of the map to track contacts. inflation_v_per_mm: as there; none: not known. static: of the
    output at rest."""
    assert response.noise_v is not None
    text, scale = encoded(np.concatenate([response.coefficients, response.depth_slope[None]]))
    return ContactCalibration(
        coefficients=text,
        scale_v=scale,
        knots=response.coefficients.shape[1],
        half_mm=response.half_mm,
        spacing_mm=response.spacing_mm,
        chamber_mm=response.chamber_mm,
        depth_mm=response.depth_mm,
        noise_v=tuple(float(v) for v in response.noise_v),
        floor_v=float(response.floor_v),
        gain_sd=float(response.gain_sd),
        depth_sd_mm=response.depth_sd_mm or ContactCalibration.depth_sd_mm,
        inflation_v_per_mm=inflation_v_per_mm,
        static_v=() if static is None else tuple(static.mean_v.tolist()),
        static_covariance_v2=() if static is None else tuple(map(tuple, static.covariance_v2.tolist())),
    )


def response_of(card: Card) -> ResponseMap:
    """The map that a card carries: without the lag, which its conditioning undoes, and the drift, which it has not.

    Raises:
        ValueError: it carries none.
    """
    contact = card.contact
    if contact is None:
        raise ValueError("the card carries no response map")
    surfaces = contact.splines()
    return ResponseMap(
        surfaces[:PARTS],
        surfaces[PARTS],
        (contact.chamber_mm[0], contact.chamber_mm[1]),
        card.reference_mm,
        depth_mm=contact.depth_mm,
        noise_v=np.array(contact.noise_v),
        floor_v=contact.floor_v,
        gain_sd=contact.gain_sd,
        axes=len(card.conditioning.touch_axes),
        rim=card.conditioning.onset == ONSETS[0],
        spacing_mm=contact.spacing_mm,
        **_heights(card),
    )


def _heights(card: Card) -> dict[str, Any]:
    """What a map has of the heights of the skin that a card is for."""
    heights = card.heights
    if heights is None:
        return {}
    return {
        "height_mm": heights.height_mm,
        "height_slope": heights.splines(),
        "height_range_mm": (heights.lowest_mm, heights.highest_mm),
    }

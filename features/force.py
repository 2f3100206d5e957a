"""The force of an estimated contact."""

import math

import numpy as np

from softslide.features.card import HALF_WIDTH_SD
from softslide.features.contact.force_map import ForceMap, weights
from softslide.features.estimate import Contact, Estimate
from softslide.features.stream.tracker import SlideState

# The skin's force as a share of the full contact's, while its outputs are the share g of the full contact's:
# g (1 + PRESS_BEND (1 - g)), with a 90 % half-width of PRESS_SPREAD (1 - g) of itself (ten presses of the solved skin,
# experiments/LOG.md).
PRESS_BEND = 0.28
PRESS_SPREAD = 0.25
STEP_MM = 0.5  # between the places of a line that are looked at for the largest force


class ForceReader:
    """Reads a map at the place of an estimate."""

    def __init__(self, forces: ForceMap) -> None:
        self._map, self._surface = forces, forces.surface()
        self._back_mm = np.arange(0.0, 2 * math.sqrt(2.0) * forces.half_mm, STEP_MM)

    def at(
        self,
        x_mm: np.ndarray,
        y_mm: np.ndarray,
        direction_rad: np.ndarray | None,
        depth_mm: np.ndarray | float,
    ) -> np.ndarray:
        """Forces (N, 3) mN along x, along y and normal at (N,) places; direction_rad: None without sliding."""
        each = weights(direction_rad, depth_mm - self._map.depth_mm, len(x_mm))
        return np.einsum("np,npc->nc", each, self._surface.at(x_mm, y_mm)[:, 0])

    def with_force(self, estimate: Estimate, gain: float = 1.0) -> Estimate:
        """The estimate with the force; unchanged where it is not valid or has no place.

        gain: the outputs' share of the full contact's, while one is pressed on or lifted. While a contact is felt it is
        the force now; of a slide that has ended, the largest on its line. The interval
        holds the map's own uncertainty and that of place and depth. Without a depth the map's is taken.
        """
        if not (estimate.valid and math.isfinite(estimate.x_mm)):
            return estimate
        heading = math.radians(estimate.direction_deg)
        direction = None if estimate.contact is Contact.PRESS else np.array([heading])
        depth_mm = estimate.depth_mm if math.isfinite(estimate.depth_mm) else self._map.depth_mm
        x, y = np.array([estimate.x_mm]), np.array([estimate.y_mm])
        if estimate.state is SlideState.ENDED and direction is not None:
            x, y = x - self._back_mm * math.cos(heading), y - self._back_mm * math.sin(heading)
            largest = self.at(x, y, np.full(len(x), heading), depth_mm)[:, 2].argmax()
            x, y = x[[largest]], y[[largest]]
        read = self._surface.at(x, y)[0]
        each = weights(direction, depth_mm - self._map.depth_mm, 1)[0]
        share = gain * (1 + PRESS_BEND * (1 - gain))
        force, along_x, along_y = share * np.einsum("p,kpc->kc", each, read)
        widths = (
            estimate.x_hi_mm - estimate.x_lo_mm,
            estimate.y_hi_mm - estimate.y_lo_mm,
            estimate.depth_hi_mm - estimate.depth_lo_mm,
        )
        # What has no interval adds nothing to that of the force.
        half_widths = np.array([width / 2 if math.isfinite(width) else 0.0 for width in widths])
        normal, tangential = max(float(force[2]), 0.0), math.hypot(force[0], force[1])
        slopes = np.stack([along_x, along_y, share * read[0, 3]])
        # Of the tangential force that of its size.
        in_plane = slopes[:, :2] @ force[:2] / max(tangential, 1e-9)
        common = math.hypot(HALF_WIDTH_SD * self._map.relative_sd, PRESS_SPREAD * (1 - gain))
        normal_half, tangential_half = (
            math.hypot(common * size, *(slope * half_widths).tolist())
            for size, slope in ((normal, slopes[:, 2]), (tangential, in_plane))
        )
        return estimate._replace(
            force_mn=normal,
            force_lo_mn=max(normal - normal_half, 0.0),
            force_hi_mn=normal + normal_half,
            tangential_force_mn=tangential,
            tangential_force_lo_mn=max(tangential - tangential_half, 0.0),
            tangential_force_hi_mn=tangential + tangential_half,
        )

"""Re-runs a tracker over the last 0.5 s without an accelerometer that was found faulty."""

from typing import NamedTuple

import numpy as np

from softslide.features.contact.track import Track
from softslide.features.contact.tracker import ContactTracker, StraightFit
from softslide.features.stream.faults import FROZEN_BLOCKS


class _Block(NamedTuple):
    volts: np.ndarray
    touched: bool
    usable: np.ndarray


class ReplayingTracker:
    """A tracker of several accelerometers; it is pushed and read as the tracker that it holds.

    An accelerometer is found faulty up to FROZEN_BLOCKS after it failed, and what it showed meanwhile has led the
    track astray. The tracker then goes back to a copy of itself from before, and reads the blocks since without that
    accelerometer.
    """

    def __init__(self, tracker: ContactTracker) -> None:
        self._tracker = tracker
        self.reset()

    def reset(self) -> None:
        """Forgets the contact and the last blocks."""
        self._tracker.reset()
        self._start_anew()

    def push(self, volts: np.ndarray, touched: bool, usable: np.ndarray) -> Track | None:
        """One block, as in `ContactTracker.push`. -> the contact, None if none is tracked."""
        block = _Block(volts, touched, usable)
        if self._blocks and (self._blocks[-1].usable & ~usable).any():
            self._go_back(usable)
        self._keep(block)
        return self._tracker.push(*block)

    def past(self, blocks: int) -> Track | None:
        """As `ContactTracker.past`."""
        return self._tracker.past(blocks)

    def offer(self, fit: StraightFit) -> None:
        """As `ContactTracker.offer`."""
        self._tracker.offer(fit)

    def _start_anew(self) -> None:
        # Two copies, so that the older is never younger than the longest fault that is not yet found.
        self._older, self._newer = self._tracker.copied(), self._tracker.copied()
        self._blocks: list[_Block] = []  # since the older copy
        self._since_newer = 0

    def _keep(self, block: _Block) -> None:
        if self._since_newer == FROZEN_BLOCKS:
            self._blocks = self._blocks[-FROZEN_BLOCKS:]
            self._older, self._newer, self._since_newer = self._newer, self._tracker.copied(), 0
        self._blocks.append(block)
        self._since_newer += 1

    def _go_back(self, usable: np.ndarray) -> None:
        blocks, self._tracker = self._blocks, self._older
        self._start_anew()
        for block in blocks:
            without = block._replace(usable=block.usable & usable)
            self._keep(without)
            self._tracker.push(*without)

"""Anderson acceleration of a fixed-point iteration: the combination of the last iterates with the least correction.

D. G. Anderson, J. ACM 12 (1965) 547; in the form of H. F. Walker and P. Ni, SIAM J. Numer. Anal. 49 (2011) 1715.
"""

import numpy as np

DEPTH = 10
# Relative; keeps the normal equations regular once corrections hardly change.
RIDGE = 1e-10


class AndersonMixing:
    """Mixes the corrections of a fixed-point iteration; `restart` when the iteration's map changes."""

    def __init__(self, size: int) -> None:
        self._changes = np.zeros((DEPTH, size))  # of the correction, from one iterate to the next
        self._moves = np.zeros((DEPTH, size))  # of iterate and correction together
        self.restart()

    def restart(self) -> None:
        self._last: tuple[np.ndarray, np.ndarray] | None = None
        self._count = 0

    def step(self, iterate: np.ndarray, correction: np.ndarray) -> np.ndarray:
        """The step to take from `iterate` (n,), given the correction (n,) that would be taken without mixing."""
        if self._last is not None:
            row = self._count % DEPTH
            self._changes[row] = correction - self._last[1]
            self._moves[row] = iterate - self._last[0] + self._changes[row]
            self._count += 1
        self._last = iterate.copy(), correction
        used = min(self._count, DEPTH)
        changes = self._changes[:used]
        normal = changes @ changes.T
        normal[np.diag_indices(used)] *= 1 + RIDGE
        return correction - np.linalg.solve(normal, changes @ correction) @ self._moves[:used]

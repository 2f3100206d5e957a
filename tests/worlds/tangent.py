"""The law that a tangent is the slope of its residual."""

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sparse

from pipeline.skin.system import Load, State, System

STEP = 1e-6  # mm, or rad of a board


def expect_tangent_is_slope(system: System, state: State, load: Load, columns: Iterable[int]) -> None:
    """Central differences of the residual beside these columns of the tangent."""
    system.tangent(state, load)
    matrix = (system.pattern + sparse.triu(system.pattern, 1).T).tocsc()
    for column in columns:
        move = np.zeros(system.size)
        move[column] = STEP
        ahead, behind = (
            system.residual(State(state.unknowns + s * move, state.rotations), load)[0] for s in (1, -1)
        )
        slope = (ahead - behind) / (2 * STEP)
        assert np.abs(slope - matrix[:, [column]].toarray().ravel()).max() < 1e-6 * np.abs(slope).max() + 1e-8

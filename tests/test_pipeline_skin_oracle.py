"""The same skin, board and air in FElupe: another assembly, another solver, the board a very stiff solid."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from square_skin import square_skin

from softslide.experiments.studies.felupe_path import felupe_path
from softslide.pipeline.skin.mesh import skin_mesh
from softslide.pipeline.skin.solved_line import gravity
from softslide.pipeline.skin.solver import Skin
from softslide.pipeline.skin.system import Material

pytest.importorskip("felupe")
SENSITIVITY_V_PER_G = 0.8
PRESSURE_MPA = 6e-4


def skin_with(friction: float) -> Skin:
    return Skin(skin_mesh(square_skin()), Material(0.07 / 3, 2.0, friction, 3.0))


def volts_of(skin: Skin, places: np.ndarray) -> np.ndarray:
    """Of the board (3,) V, from FElupe's places (n, 3) mm of its nodes."""
    own = skin.mesh.board_of == 0
    arms = [p[own] - p[own].mean(axis=0) for p in (skin.mesh.nodes, places)]
    turned = np.linalg.lstsq(*arms, rcond=None)[0].T
    return SENSITIVITY_V_PER_G * gravity(turned[None])[0]


def test_inflation_and_a_slide_with_friction_agree_with_felupe() -> None:
    skin, solve = skin_with(0.2), spsolve
    inflated = skin.inflate(PRESSURE_MPA)
    centres = np.array([[x, 2.5, 4.0 + 3.0 - 0.6] for x in np.arange(-28.0, -8.0, 1.25)])
    postures, _ = skin.slide(inflated, PRESSURE_MPA, centres)
    solvers: list[Callable] = [solve] * len(centres)
    theirs = list(felupe_path(skin, PRESSURE_MPA, centres, solve, solvers))
    assert np.abs(theirs[0] - skin.system.places(inflated)).max() < 2e-3
    own = [SENSITIVITY_V_PER_G * gravity(posture.rotations)[0] for posture in (inflated, *postures)]
    volts = np.array([own, [volts_of(skin, places) for places in theirs]])
    assert abs(volts[0, 0, 0]) > 0.08
    assert np.abs(volts[0] - volts[1])[0, :2].max() < 5e-5
    assert np.ptp(volts[0, :, 0]) > 0.08
    assert np.abs(volts[0] - volts[1])[:, :2].max() < 5e-4

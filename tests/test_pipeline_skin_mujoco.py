"""The same slide over a MuJoCo flex: another theory, integrated in time until it creeps along with the indenter.

Coarse on purpose. MuJoCo's flex is a thin shell of a Saint Venant-Kirchhoff material that is touched like a rounded
plate; the skin is a thick neo-Hookean solid, on a mesh that is itself worth 5 %. They were found 1 % apart in
height, 16 to 27 % in tilt and 1.25 mm in its places, and the bounds lie just beyond. Near the rim the rounded
plate is touched where the skin is not: the last 5 mm are left out.
"""

from dataclasses import replace

import numpy as np
import pytest
from square_skin import square_skin

from softslide.pipeline.skin.lines import Line
from softslide.pipeline.skin.mesh import skin_mesh
from softslide.pipeline.skin.solved_line import gravity, solve_line
from softslide.pipeline.skin.solver import Skin
from softslide.pipeline.skin.system import Material

mujoco = pytest.importorskip("mujoco")

HALF_MM, THICKNESS_MM, CELL_MM = 25.0, 4.0, 2.5
YOUNGS_MPA, AIR_MPA = 0.07, 0.001
BOARD_X_MM, BOARD_HALF_MM = 5.0, 5.0
OFFSET_MM, DEPTH_MM, RADIUS_MM = 2.5, 0.6, 3.0
# Masses and drag are free where only rest matters: a node weighs 1 (N s^2/mm), and the time step is stable for it.
STEP_S, DRAG_PER_S = 0.4, 0.05
INFLATING_STEPS, STEP_MM = 800, 0.02


class Flex:
    """A clamped shell with a rigid board in it, air under it and an indenter over it."""

    def __init__(self) -> None:
        ticks = np.arange(-HALF_MM, HALF_MM + 0.1, CELL_MM)
        n = len(ticks)
        places = np.array([(x, y) for y in ticks for x in ticks])
        rim = (np.abs(places) == HALF_MM).any(axis=1)
        board = (np.abs(places - [BOARD_X_MM, 0.0]) <= BOARD_HALF_MM).all(axis=1)
        each = enumerate(zip(rim, board, strict=True))
        names = ["world" if r else "board" if b else f"n{i}" for i, (r, b) in each]
        local = np.where(board[:, None], places - [BOARD_X_MM, 0.0], np.where(rim[:, None], places, 0.0))
        vertices = np.column_stack([local, np.where(rim, THICKNESS_MM / 2, 0.0)])
        corner = np.array([j * n + i for j in range(n - 1) for i in range(n - 1)])
        quads = corner[:, None] + [0, 1, n + 1, n]
        # The diagonals alternate, so that the mesh favours no direction.
        rising = ((corner % n + corner // n) % 2 == 1)[:, None, None]
        split = np.where(rising, quads[:, [[0, 1, 2], [0, 2, 3]]], quads[:, [[0, 1, 3], [1, 2, 3]]])
        self.triangles = split.reshape(-1, 3)
        slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
        nodes = "".join(
            f'<body name="{name}" pos="{x} {y} {THICKNESS_MM / 2}">'
            f'<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>{slides}</body>'
            for name, (x, y) in zip(names, places, strict=True)
            if name not in ("world", "board")
        )
        turning = board.sum() * BOARD_HALF_MM**2 / 3
        self.model = mujoco.MjModel.from_xml_string(
            f"""<mujoco>
            <option timestep="{STEP_S}" gravity="0 0 0" integrator="Euler"/>
            <worldbody>
              <body name="board" pos="{BOARD_X_MM} 0 {THICKNESS_MM / 2}"><freejoint/>
                <inertial pos="0 0 0" mass="{board.sum()}" diaginertia="{turning} {turning} {2 * turning}"/></body>
              {nodes}
              <body name="indenter" mocap="true" pos="-60 0 0">
                <geom type="capsule" fromto="0 0 0 0 0 30" size="{RADIUS_MM}" solref="{2 * STEP_S} 1"/></body>
            </worldbody>
            <deformable><flex name="skin" dim="2" radius="{THICKNESS_MM / 2}" body="{" ".join(names)}"
              vertex="{_listed(vertices)}" element="{_listed(self.triangles)}">
              <elasticity young="{YOUNGS_MPA}" poisson="0.49" thickness="{THICKNESS_MM}" elastic2d="both"/>
              <contact selfcollide="none" condim="1" solref="{2 * STEP_S} 1"/>
            </flex></deformable></mujoco>"""
        )
        self.data = mujoco.MjData(self.model)
        self.board = self.model.body("board").id

    def step(self, pressure_mpa: float) -> None:
        """A step of time under air that follows the shell, and drag."""
        model, data = self.model, self.data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_flex(model, data)
        places, owner = data.flexvert_xpos, model.flex_vertbodyid
        a, b, c = (places[self.triangles[:, i]] for i in range(3))
        at = self.triangles.ravel()
        push = np.repeat(pressure_mpa * np.cross(b - a, c - a) / 6, 3, axis=0)
        wrench = np.zeros((model.nbody, 6))
        np.add.at(wrench[:, :3], owner[at], push)
        own = owner[at] == self.board
        wrench[self.board, 3:] = np.cross(places[at[own]] - data.xipos[self.board], push[own]).sum(axis=0)
        data.xfrc_applied[:] = wrench
        mujoco.mj_mulM(model, data, data.qfrc_applied, data.qvel)
        data.qfrc_applied *= -DRAG_PER_S
        mujoco.mj_step(model, data)

    @property
    def height_mm(self) -> float:
        return float(self.data.flexvert_xpos[:, 2].max()) - THICKNESS_MM / 2

    @property
    def tilt_g(self) -> np.ndarray:
        return gravity(self.data.xmat[self.board].reshape(1, 3, 3))[0, :2]


def _listed(values: np.ndarray) -> str:
    return " ".join(map(str, values.ravel()))


def test_a_slide_over_a_mujoco_flex_is_alike():
    flex = Flex()
    for n in range(INFLATING_STEPS):
        flex.step(AIR_MPA * min(1.0, 5 * n / INFLATING_STEPS))
    height, at_rest = flex.height_mm, flex.tilt_g
    x = np.arange(-31.0, 20.0 + STEP_MM, STEP_MM)
    theirs = []
    for place in x:
        flex.data.mocap_pos[0] = [place, OFFSET_MM, THICKNESS_MM + RADIUS_MM - DEPTH_MM]
        flex.step(AIR_MPA)
        theirs.append(flex.tilt_g - at_rest)

    design = square_skin((BOARD_X_MM, 0.0), size_mm=2.5)
    assert (design.skin_thickness_mm, design.indenter_diameter_mm) == (THICKNESS_MM, 2 * RADIUS_MM)
    design = replace(design, skin=replace(design.skin, friction=0.0))
    skin = Skin(skin_mesh(design), Material(YOUNGS_MPA / 3, 2.0, 0.0, RADIUS_MM))
    inflated = skin.inflate(AIR_MPA)
    assert height == pytest.approx(skin.height(inflated), rel=0.05)
    assert at_rest[0] == pytest.approx(gravity(inflated.rotations)[0, 0], rel=0.3)

    along = np.arange(-30.0, 30.1, 1.25)
    values = solve_line(design, Line(0, 1, OFFSET_MM), along, DEPTH_MM, AIR_MPA, inflated)[0]
    inner = np.abs(along) <= 20.0
    along, ours = along[inner], values[inner, :2]
    theirs = np.column_stack([np.interp(along, x, v) for v in np.transpose(theirs)])
    for axis in (0, 1):
        assert np.corrcoef(ours[:, axis], theirs[:, axis])[0, 1] > 0.95
        assert np.corrcoef(ours[::-1, axis], theirs[:, axis])[0, 1] < 0.9
    assert theirs.max(axis=0) == pytest.approx(ours.max(axis=0), rel=0.3)
    assert theirs[:, 0].min() == pytest.approx(ours[:, 0].min(), rel=0.3)
    for place in (np.argmin, np.argmax):
        assert abs(along[place(ours[:, 0])] - along[place(theirs[:, 0])]) <= 2.5
    turns = [along[np.flatnonzero(np.diff(np.sign(v[:, 0])))] for v in (ours, theirs)]
    assert len(turns[0]) == len(turns[1]) == 1
    assert abs(turns[0] - turns[1]) <= 2.5

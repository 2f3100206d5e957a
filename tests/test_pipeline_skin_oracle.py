"""The same skin, board and air in FElupe: another assembly, another solver, the board a very stiff solid."""

import numpy as np
import pytest

from experiments.bench.felupe_path import board_elements, felupe_path
from pipeline.sensor import Accelerometer, MeshSize, Sensor
from pipeline.skin.mesh import skin_mesh
from pipeline.skin.solved_line import gravity
from pipeline.skin.solver import Skin
from pipeline.skin.system import Material

fem = pytest.importorskip("felupe")
SENSITIVITY_V_PER_G = 0.8


def test_inflated_skin_and_board_agree_with_felupe():
    parts = (Accelerometer("a0", 5.0, 0.0),)
    design = Sensor("s", 1000.0, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 5e-4, parts, mesh=MeshSize(5.0))
    mesh, pressure = skin_mesh(design), 6e-4
    skin = Skin(mesh, Material(0.07 / 3, 2.0, 0.0, 3.0))
    ours = skin.inflate(pressure)

    board = board_elements(mesh)
    cells = {"skin": mesh.elements.astype(int), "board": board, "all": np.vstack([mesh.elements, board])}
    field = {
        name: fem.FieldContainer(
            [fem.Field(fem.RegionHexahedron(fem.Mesh(mesh.nodes, c, "hexahedron")), dim=3)]
        )
        for name, c in cells.items()
    }
    below = fem.RegionHexahedronBoundary(field["all"].region.mesh, mask=mesh.nodes[:, 2] == 0)
    air = fem.SolidBodyPressure(fem.FieldContainer([fem.Field(below, dim=3)]))
    items = [
        fem.SolidBodyNearlyIncompressible(fem.NeoHooke(mu=0.07 / 3), field["skin"], bulk=2.0),
        fem.SolidBodyNearlyIncompressible(fem.NeoHooke(mu=700.0), field["board"], bulk=2000.0),
        air,
    ]
    now = field["all"]
    held = fem.dof.partition(now, {"rim": fem.Boundary(now[0], mask=mesh.clamped)})
    for air.results.pressure in np.linspace(0, pressure, 9)[1:]:
        now = fem.newtonraphson(
            items=items, x0=now, dof0=held[0], dof1=held[1], ext0=np.zeros(len(held[0])), tol=1e-6, verbose=0
        ).x

    theirs = mesh.nodes + now[0].values
    assert np.abs(theirs - skin.system.places(ours)).max() < 2e-3
    own = mesh.board_of == 0
    arms = [places[own] - places[own].mean(axis=0) for places in (mesh.nodes, theirs)]
    turned = np.linalg.lstsq(*arms, rcond=None)[0].T
    volts = SENSITIVITY_V_PER_G * (gravity(turned[None]) - gravity(ours.rotations))
    assert np.abs(SENSITIVITY_V_PER_G * gravity(ours.rotations)[0, 0]) > 0.08
    assert np.abs(volts[0, :2]).max() < 5e-5


def test_a_slide_with_friction_agrees_with_felupe():
    from scipy.sparse.linalg import spsolve

    parts = (Accelerometer("a0", 5.0, 0.0),)
    design = Sensor("s", 1000.0, (50.0, 50.0), 4.0, 6.0, 0.035, (5.0, 0.0), 5e-4, parts, mesh=MeshSize(5.0))
    mesh, pressure = skin_mesh(design), 6e-4
    skin = Skin(mesh, Material(0.07 / 3, 2.0, 0.2, 3.0))
    inflated = skin.inflate(pressure)
    centres = np.array([[x, 2.5, 4.0 + 3.0 - 0.6] for x in np.arange(-28.0, -8.0, 1.25)])
    postures, _ = skin.slide(inflated, pressure, centres)
    theirs = list(felupe_path(mesh, skin.material, pressure, centres, spsolve, [spsolve] * len(centres)))
    own = mesh.board_of == 0
    volts = []
    for posture, places in zip([inflated, *postures], theirs, strict=True):
        arms = [p[own] - p[own].mean(axis=0) for p in (mesh.nodes, places)]
        turned = np.linalg.lstsq(*arms, rcond=None)[0].T
        volts.append(
            SENSITIVITY_V_PER_G * np.array([gravity(turned[None])[0], gravity(posture.rotations)[0]])
        )
    volts = np.array(volts)
    assert np.ptp(volts[:, 1, 0]) > 0.08
    assert np.abs(volts[:, 0] - volts[:, 1])[:, :2].max() < 5e-4

"""The skin's mechanics against laws and known solutions."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sparse
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from square_skin import square_skin

from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin import material
from softslide.pipeline.skin.anderson import AndersonMixing
from softslide.pipeline.skin.linear import Pardiso, SuperLU
from softslide.pipeline.skin.lines import Line, mirror
from softslide.pipeline.skin.mesh import Mesh, plate, skin_mesh
from softslide.pipeline.skin.solved_line import gravity, solve_line
from softslide.pipeline.skin.solver import NoEquilibrium, Skin
from softslide.pipeline.skin.system import Load, Material, State

ECOFLEX = Material(0.07 / 3, 2.0, 0.2, 3.0)
AIR_MPA = 0.001


def bare_plate(cells: int, thickness: float, half: float = 25.0, layers: int = 3) -> Mesh:
    line = np.linspace(-half, half, cells + 1)
    return plate(line, line, np.linspace(0, thickness, layers + 1), np.empty((0, 2)), np.ones(2), (0, 0))


@pytest.fixture(scope="module")
def skin() -> Skin:
    return Skin(skin_mesh(square_skin()), ECOFLEX)


def element_forces(nodes: np.ndarray, mesh: Mesh) -> np.ndarray:
    gradients, volumes = mesh.gradients
    blocks = (nodes[mesh.elements].transpose(0, 2, 1), gradients.transpose(0, 1, 3, 2), volumes)
    found = []
    for x, g, v in zip(*map(material.in_lanes, blocks), strict=True):
        force = np.empty(material.NODAL)
        assert material.forces(x, g, v, 0.02, 2.0, np.empty(material.ROOM), force)
        found.append(force.reshape(3, 8, material.LANES).T)
    forces = np.zeros_like(nodes)
    np.add.at(forces, mesh.elements, np.concatenate(found)[: len(mesh.elements)])
    return forces


def test_patch_of_distorted_elements_carries_a_homogeneous_strain():
    mesh = bare_plate(3, 6.0, half=3.0)
    inside = ~mesh.clamped & (mesh.nodes[:, 2] > 0.1) & (mesh.nodes[:, 2] < 5.9)
    shaken = mesh.nodes + inside[:, None] * np.random.default_rng(1).uniform(-0.3, 0.3, mesh.nodes.shape)
    mesh = replace(mesh, nodes=shaken)
    strain = np.array([[1.2, 0.1, 0.0], [0.05, 0.9, 0.2], [0.0, -0.1, 1.1]])
    assert inside.sum() == 8
    assert np.abs(element_forces(shaken @ strain.T, mesh)[inside]).max() < 1e-12
    bent = shaken @ strain.T + 0.02 * shaken[:, :1] ** 2
    assert np.abs(element_forces(bent, mesh)[inside]).max() > 1e-4


def membrane_height(pressure: float, radius: float, thickness: float, shear: float) -> float:
    """A clamped circular neo-Hookean membrane (Adkins and Rivlin 1952), by shooting on the pole's stretch."""

    def meridional_stretch(tension: float, hoop: float) -> float:
        return brentq(lambda m: shear * thickness * (m / hoop - 1 / (m * hoop) ** 3) - tension, 0.5, 20)

    def profile(pole: float) -> tuple[float, float]:
        def slope(place: float, state: np.ndarray) -> list[float]:
            r, _, angle, tension = state
            hoop = r / place
            stretch = meridional_stretch(tension, hoop)
            hoop_tension = shear * thickness * (hoop / stretch - 1 / (stretch * hoop) ** 3)
            curvature = (pressure - hoop_tension * np.sin(angle) / r) / tension
            dr = stretch * np.cos(angle)
            return [dr, stretch * np.sin(angle), stretch * curvature, dr * (hoop_tension - tension) / r]

        near = 1e-4 * radius
        tension = shear * thickness * (1 - pole**-6)
        first = [pole * near, 0.0, pole * near * pressure / (2 * tension), tension]
        end = solve_ivp(slope, (near, radius), first, rtol=1e-8, atol=1e-10).y[:, -1]
        return end[0], end[1]

    pole = brentq(lambda p: profile(p)[0] - radius, 1.05, 1.4)
    return profile(pole)[1]


def test_inflated_disc_is_the_membrane_of_adkins_and_rivlin():
    radius, thickness, pressure = 25.0, 0.5, 1.6e-4
    mesh = bare_plate(16, thickness, half=1.0, layers=1)
    u, v = mesh.nodes[:, 0], mesh.nodes[:, 1]
    round_u, round_v = u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)
    disc = np.column_stack([radius * round_u, radius * round_v, mesh.nodes[:, 2]])
    skin = Skin(replace(mesh, nodes=disc), ECOFLEX)
    known = membrane_height(pressure, radius, thickness, ECOFLEX.shear_mpa)
    assert known > 6.0
    assert skin.height(skin.inflate(pressure)) == pytest.approx(known, rel=0.02)
    wrong = Skin(replace(mesh, nodes=disc), replace(ECOFLEX, shear_mpa=1.2 * ECOFLEX.shear_mpa))
    assert wrong.height(wrong.inflate(pressure)) != pytest.approx(known, rel=0.02)


def order(values: list[np.ndarray]) -> float:
    """The observed order of three values, each on a mesh twice as fine as the one before."""
    coarse, middle, fine = values
    return float(np.log2(np.linalg.norm(middle - coarse) / np.linalg.norm(fine - middle)))


def test_refinement_of_a_smooth_solution_converges_at_the_element_s_order():
    # A cube whose whole surface is moved smoothly: no free edge, hence no singularity, and order 2.
    places = []
    for cells in (4, 8, 16):
        mesh = bare_plate(cells, 2.0, half=1.0, layers=cells)
        mesh = replace(mesh, clamped=mesh.clamped | (np.abs(mesh.nodes[:, 2] - 1.0) == 1.0))
        skin = Skin(mesh, replace(ECOFLEX, bulk_mpa=0.1))
        x, y, _ = mesh.nodes.T
        moved = np.stack([0.15 * y**2, 0.1 * x**3, 0.15 * x**2], 1)
        skin.system.mesh = replace(mesh, nodes=mesh.nodes + moved)
        state, _ = skin.equilibrium(skin.system.rest(), Load(0.0), 1e-7)
        every = slice(None, None, cells // 4)
        grid = skin.system.places(state).reshape(cells + 1, cells + 1, cells + 1, 3)
        places.append(grid[every, every, every])
    assert np.abs(places[1] - places[0]).max() > 1e-3
    assert 1.8 < order(places) < 2.4


def test_refinement_of_an_inflated_skin_converges_as_its_clamped_edge_lets_it():
    heights = []
    for cells in (6, 12, 24):
        skin = Skin(bare_plate(cells, 4.0, layers=2), ECOFLEX)
        heights.append(np.array(skin.height(skin.inflate(3e-4))))
    # Where a clamped face meets a free one, displacements go as r^0.595 in an incompressible solid (Williams 1952),
    # which ends at h^1.19; away from there trilinear elements have order 2.
    assert 1.19 < order(heights) < 2.0


@cache
def inflated(design: Sensor) -> State:
    return Skin(skin_mesh(design), ECOFLEX).inflate(AIR_MPA)


@cache
def slide(design: Sensor, line: Line, friction: float) -> np.ndarray:
    rubbing = replace(design, skin=replace(design.skin, friction=friction))
    return solve_line(rubbing, line, np.arange(-30, 30.1, 1.25), 0.5, AIR_MPA, inflated(design))[0]


def test_without_friction_the_way_does_not_matter():
    design = square_skin()
    forward, backward = (slide(design, Line(0, sense, 2.0), 0.0)[:, :3] for sense in (1, -1))
    assert np.ptp(forward[:, 0]) > 0.3
    assert np.abs(forward - backward).max() < 1e-3
    rough, rough_back = (slide(design, Line(0, sense, 2.0), 0.2)[:, :3] for sense in (1, -1))
    assert np.abs(rough - rough_back).max() > 5e-3


ONE, TWO = square_skin(), square_skin((-8.0, 0.0), (8.0, 0.0))


@pytest.mark.parametrize(
    ("design", "axis", "line", "other"),
    [
        (ONE, 1, Line(0, 1, 7.5), Line(0, 1, -7.5)),
        (ONE, 1, Line(1, -1, 7.5), Line(1, 1, 7.5)),
        (TWO, 0, Line(0, -1, 2.0), Line(0, 1, 2.0)),
    ],
)
def test_mirrored_lines_give_mirrored_postures(design, axis, line, other):
    found, mirrored = slide(design, line, 0.2), mirror(slide(design, other, 0.2), line, axis, design)
    assert np.abs(found[:, :3]).max() > 0.05
    assert np.abs(found - mirrored).max() < 2e-3
    assert np.abs(found - mirrored[::-1]).max() > 0.02


def test_skin_is_at_rest_where_a_line_ends():
    values = slide(square_skin(), Line(0, 1, 0.0), 0.2)
    assert np.abs(values[:, :3]).max() > 0.2
    assert np.abs(values[[0, -1]]).max() < 1e-4
    assert values[:, -1].min() > -1e-9


def test_a_jump_into_the_dome_is_refused_and_not_taken_for_an_equilibrium(skin):
    inflated = skin.inflate(AIR_MPA)
    centres = np.array([[-30.0, 0, 6.5], [0.0, 0, 6.5]])
    steps = np.column_stack([np.arange(-30, 0.1, 1.25), np.zeros(25), np.full(25, 6.5)])
    true = skin.slide(inflated, AIR_MPA, steps)[0][-1]
    assert true is not None
    jumped = skin.slide(inflated, AIR_MPA, centres)[0][-1]
    assert jumped is not None
    assert np.abs(gravity(jumped.rotations) - gravity(true.rotations)).max() < 1e-4
    with pytest.raises(NoEquilibrium, match="pierces"):
        skin._settle(inflated, Load(AIR_MPA, np.array([0.0, 0.0, -3.0])))


def made(kind: type[Pardiso | SuperLU]) -> Pardiso | SuperLU:
    try:
        return kind()
    except ImportError:
        pytest.skip("MKL is not installed")


def test_both_linear_solvers_agree(skin):
    right, _ = skin.system.residual(skin.inflate(AIR_MPA), Load(1.1 * AIR_MPA), wants_tangent=True)
    answers = []
    for kind in (Pardiso, SuperLU):
        solver = made(kind)
        solver.factor(skin.system.pattern)
        assert solver.negative == 0
        answers.append(solver.solve(right))
    # PARDISO's factor is in single precision.
    assert np.abs(answers[0] - answers[1]).max() < 1e-3 * np.abs(answers[1]).max()


@pytest.mark.parametrize("kind", [Pardiso, SuperLU])
def test_negative_pivots_are_the_negative_eigenvalues(skin, kind):
    solver = made(kind)
    skin.system.residual(skin.inflate(AIR_MPA), Load(AIR_MPA), wants_tangent=True)
    matrix = skin.system.pattern.copy()
    values = np.linalg.eigvalsh((matrix + sparse.triu(matrix, 1).T).toarray())
    assert values[0] > 0
    matrix.setdiag(matrix.diagonal() - (values[4] + values[5]) / 2)
    solver.factor(matrix.tocsr())
    assert solver.negative == 5


def test_anderson_s_mixing_solves_a_linear_problem_in_as_many_steps_as_it_has_dimensions():
    random = np.random.default_rng(3)
    slope, solution = random.normal(size=(4, 4)), random.normal(size=4)
    mixing, place = AndersonMixing(4), np.zeros(4)
    for _ in range(5):
        assert np.abs(place - solution).max() > 1e-3
        place = place + mixing.step(place, slope @ (solution - place))
    assert np.abs(place - solution).max() < 1e-6


def test_inverse_cube_root_is_exact_for_what_an_element_bears():
    volumes = np.geomspace(0.02, 20.0, 101)
    found = np.array([material.inverse_cube_root(j) for j in volumes])
    assert np.abs(found * np.cbrt(volumes) - 1).max() < 1e-12


def test_height_is_reached_by_pressure_and_a_balloon_is_refused(skin):
    pressure, state = skin.inflate_to(6.0)
    assert skin.height(state) == pytest.approx(6.0, abs=2e-3)
    assert 6e-4 < pressure < 1e-3
    with pytest.raises(NoEquilibrium, match="balloons"):
        skin.inflate(0.02)

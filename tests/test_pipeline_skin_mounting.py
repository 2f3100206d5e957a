"""How the skin is held (on the base beyond the chamber, rigid or elastic, prestretched) and an indenter's edge."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sparse
from article_skin import ATLAS, of_design
from article_skin import SENSOR as ARTICLE
from square_skin import square_skin

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import check_atlas, write_atlas
from softslide.pipeline.sensor import Accelerometer, Sensor, Skin
from softslide.pipeline.skin.lines import Line, reach_mm
from softslide.pipeline.skin.mesh import plate, skin_mesh
from softslide.pipeline.skin.solved_line import material_of, skin_of, solve_line
from softslide.pipeline.skin.solver import Skin as SolvedSkin
from softslide.pipeline.skin.system import Load, State, System
from softslide.pipeline.synthesis.synthesize import sensor_of, synthesize

AIR_MPA = 0.001
DESIGN = square_skin()
OVERLAP_MM, STIFFNESS = 5.0, (0.2, 0.02)


def held(**skin: object) -> Sensor:
    return replace(DESIGN, skin=replace(DESIGN.skin, **skin))


ELASTIC = held(overlap_mm=OVERLAP_MM, base_mpa_mm=STIFFNESS)


@pytest.mark.parametrize(
    "design",
    [DESIGN, ELASTIC, held(prestretch=1.1), replace(DESIGN, indenter_edge_mm=(6.0, 0.0))],
    ids=["clamped", "elastic base", "prestretch", "edge"],
)
def test_the_tangent_is_the_residual_s_derivative(design: Sensor) -> None:
    """The air's is its symmetric half, exact where the rim is clamped; so without air on an elastic base."""
    system = System(skin_mesh(design), replace(material_of(design), friction=0.0))
    random = np.random.default_rng(2)
    state = system.accept(State(random.normal(size=system.size) * 0.05, system.rest().rotations))
    load = Load(0.0 if design is ELASTIC else AIR_MPA, np.array([3.0, 1.3, 6.0]))
    assert system.residual(state, load, wants_tangent=True)[1][2] > 0.01
    matrix = (system.pattern + sparse.triu(system.pattern, 1).T).tocsc()
    touched = np.flatnonzero(np.abs(system.residual(state, load)[0] - system.residual(state, Load(0.0))[0]))
    board = range(system.size - 6, system.size)
    step = 1e-6  # mm, or rad of a board
    for column in (*random.integers(0, system.size - 6, 20), *random.choice(touched, 20), *board):
        move = np.zeros(system.size)
        move[column] = step
        places = (State(state.unknowns + sign * move, state.rotations) for sign in (1, -1))
        ahead, behind = (system.residual(place, load)[0] for place in places)
        slope = (ahead - behind) / (2 * step)
        assert np.abs(slope - matrix[:, [column]].toarray().ravel()).max() < 1e-6 * np.abs(slope).max() + 1e-8


def test_the_base_s_springs_add_up_to_its_area_and_the_air_presses_the_chamber_alone() -> None:
    mesh = skin_mesh(ELASTIC)
    on_base = (50 + 2 * OVERLAP_MM) ** 2 - 50**2
    normal, tangential = STIFFNESS
    assert mesh.springs.sum(axis=0) == pytest.approx(on_base * np.array([tangential, tangential, normal]))
    assert not mesh.clamped.any()
    system = System(mesh, material_of(ELASTIC))
    pressed, calm = (system.residual(system.rest(), Load(p))[0] for p in (AIR_MPA, 0.0))
    lifting = (pressed - calm)[2 : 3 * (len(system._free)) : 3].sum()
    assert lifting == pytest.approx(-AIR_MPA * 50**2)


def test_a_stiff_base_is_a_rigid_one_and_a_soft_one_yields() -> None:
    def rise(design: Sensor) -> float:
        skin = skin_of(design)
        return skin.height(skin.inflate(AIR_MPA))

    rigid = rise(held(overlap_mm=OVERLAP_MM))
    assert rise(held(overlap_mm=OVERLAP_MM, base_mpa_mm=(1e3, 1e3))) == pytest.approx(rigid, abs=1e-3)
    assert rise(ELASTIC) > rigid + 0.1
    # Bonded by its lower face alone, the skin turns at its edge: it rises further than one that is clamped at its side.
    assert rigid > rise(DESIGN) + 0.02


def test_a_stretched_membrane_rises_as_the_linear_one() -> None:
    """A square membrane of side a under tension T: w = 0.07367 p a^2 / T (Poisson's equation, series of Navier);
    T = G (s^2 - s^-4) t of a neo-Hookean sheet stretched s times both ways, t thick as mounted."""
    stretch, thickness, side, pressure = 1.3, 0.5, 50.0, 2e-5
    material = replace(material_of(DESIGN), friction=0.0)
    line, z = np.linspace(-side / 2, side / 2, 25), np.linspace(0, thickness, 2)
    mesh = plate(line, line, z, np.empty((0, 2)), np.ones(2), (0, 0))
    skin = SolvedSkin(replace(mesh, prestretch=stretch), material)
    flat = skin.inflate(1e-9)
    tension = material.shear_mpa * (stretch**2 - stretch**-4) * thickness
    rise = skin.height(skin.inflate(pressure)) - skin.height(flat)
    assert rise == pytest.approx(0.07367 * pressure * side**2 / tension, rel=0.03)


def test_a_slide_over_a_skin_on_its_base_begins_and_ends_at_rest() -> None:
    along = np.arange(-35.0, 35.1, 1.25)
    assert along[-1] > reach_mm(ELASTIC)[0]
    skin = skin_of(ELASTIC)
    values = solve_line(ELASTIC, Line(0, 1, 2.0), along, 0.5, AIR_MPA, skin.inflate(AIR_MPA))[0]
    assert np.abs(values[:, :3]).max() > 0.2
    assert np.abs(values[[0, -1]]).max() < 1e-4
    on_base = (np.abs(along) > 27) & (np.abs(along) < 29)
    # There the skin is touched, and squeezed between ball and base.
    assert values[on_base, -1].min() > 0.02
    assert np.abs(values[on_base, :3]).max() < 0.01


def slide(design: Sensor, axis: int, offset: float) -> np.ndarray:
    along = np.arange(-36.0, 36.1, 1.2)
    return solve_line(design, Line(axis, 1, offset), along, 0.5, AIR_MPA, skin_of(design).inflate(AIR_MPA))[0]


def test_an_edge_turned_with_its_way_turns_the_answer() -> None:
    """Over a board in the chamber's middle x and y may change places."""
    centred = square_skin((0.0, 0.0))
    across_x = slide(replace(centred, indenter_edge_mm=(0.0, 8.0)), 0, 6.0)
    across_y = slide(replace(centred, indenter_edge_mm=(8.0, 0.0)), 1, 6.0)
    swapped = across_y[:, [1, 0, 2]]
    assert np.abs(across_x[:, :3]).max() > 0.05
    assert np.abs(across_x[:, :3] - swapped).max() < 2e-3
    along_x = slide(replace(centred, indenter_edge_mm=(8.0, 0.0)), 0, 6.0)
    assert np.abs(across_x[:, :3] - along_x[:, :3]).max() > 0.02


def test_a_short_edge_is_a_ball_and_a_long_one_presses_in_proportion() -> None:
    ball = slide(DESIGN, 0, 2.0)
    nearly = slide(replace(DESIGN, indenter_edge_mm=(0.0, 1e-3)), 0, 2.0)
    assert np.abs(nearly[:, :3] - ball[:, :3]).max() < 1e-4
    # On a plate without air, bonded all over, each millimetre of an edge carries the same force.
    forces = []
    across, line, z = np.linspace(-15.0, 15.0, 25), np.linspace(-30.0, 30.0, 49), np.linspace(0.0, 4.0, 4)
    mesh = plate(across, line, z, np.empty((0, 2)), np.ones(2), (0, 0))
    mesh = replace(mesh, clamped=mesh.nodes[:, 2] == 0)
    for length in (10.0, 20.0, 30.0):
        skin = SolvedSkin(mesh, replace(material_of(DESIGN), edge_mm=(0.0, length)))
        centre, above = np.array([0.0, 0.0, 4.0 + 3.0 - 0.5]), np.array([0.0, 0.0, 1.0])
        forces.append(skin.slide(skin.system.rest(), 0.0, np.stack([centre + above, centre]))[1][-1, 2])
    assert forces[2] - forces[1] == pytest.approx(forces[1] - forces[0], rel=0.02)
    assert forces[0] > 0.1


@pytest.mark.parametrize(
    ("whole", "change", "words"),
    [
        (Skin(), {"overlap_mm": -1.0}, "overlap_mm is -1.0"),
        (Skin(), {"base_mpa_mm": (0.1, 0.1)}, "without overlap_mm"),
        (Skin(), {"overlap_mm": 5.0, "base_mpa_mm": (0.1,)}, "two positive"),
        (Skin(), {"overlap_mm": 5.0, "base_mpa_mm": (0.1, 0.0)}, "two positive"),
        (Skin(), {"prestretch": 2.0}, "prestretch is 2.0"),
        (DESIGN, {"indenter_edge_mm": (3.0, 3.0)}, "along x or along y"),
    ],
)
def test_what_cannot_be_mounted_is_refused(whole: Skin | Sensor, change: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(whole, **change)


def test_an_atlas_says_what_of_the_design_differs() -> None:
    check_atlas(ATLAS, replace(ARTICLE, name="other", adc_step_v=0.0))
    moved = replace(ARTICLE, accelerometers=(Accelerometer("a0", 6.0, 0.0),))
    with pytest.raises(InputError, match=r"a\.npz: solved for another design \(boards_mm"):
        check_atlas(ATLAS, moved, "a.npz")
    with pytest.raises(InputError, match=r"indenter_edge_mm is not given, the sensor's \[0.0, 4.0\]"):
        check_atlas(ATLAS, replace(ARTICLE, indenter_edge_mm=(0.0, 4.0)))
    with pytest.raises(InputError, match="overlap_mm"):
        check_atlas(ATLAS, replace(ARTICLE, skin=replace(ARTICLE.skin, overlap_mm=5.0)))
    design = {**ATLAS.meta["design"], "indenter_edge_mm": [0.0, 4.0]}
    edged = replace(ATLAS, meta={**ATLAS.meta, "design": design, "design_hash": "0" * 16})
    with pytest.raises(InputError, match=r"indenter_edge_mm is \[0.0, 4.0\], the sensor's not given"):
        check_atlas(edged, ARTICLE)
    assert sensor_of(edged).indenter_edge_mm == (0.0, 4.0)


def test_paths_of_an_edge_want_to_be_solved(tmp_path: Path) -> None:
    write_atlas(of_design(replace(ARTICLE, indenter_edge_mm=(0.0, 4.0))), tmp_path / "edge.npz")
    with pytest.raises(InputError, match="have the paths solved"):
        synthesize(tmp_path / "out", atlas=tmp_path / "edge.npz", seed=1, paths=3)
    assert not (tmp_path / "out").exists()

"""A design from its file: defaults, and every mistake in one line."""

from pathlib import Path

import pytest
from front_door import refused

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.atlas.solve import Grid, coarsened, solve_atlas
from softslide.pipeline.sensor import check_design, design_hash, read_sensor
from softslide.pipeline.skin.mesh import skin_mesh

PLAIN = """name = "s"
sample_rate_hz = 1000.0
chamber_mm = [50.0, 50.0]
skin_thickness_mm = 4.0
indenter_diameter_mm = 6.0
pressure_mpa = 0.035
reference_mm = [5.0, 0.0]
adc_step_v = 5e-4
"""
BOARD = """[[accelerometer]]
name = "a{n}"
x_mm = {x}
y_mm = {y}
"""


def design(folder: Path, *places: tuple[float, float], extra: str = "") -> Path:
    path = folder / "sensor.toml"
    boards = "".join(BOARD.format(n=n, x=x, y=y) for n, (x, y) in enumerate(places))
    path.write_text(PLAIN + boards + extra)
    return path


def test_a_plain_sensor_is_the_default_design(tmp_path):
    plain, default = read_sensor(design(tmp_path, (5.0, 0.0))), read_sensor(DEFAULT_SENSOR)
    assert design_hash(plain) == design_hash(default)
    assert design_hash(read_sensor(design(tmp_path, (3.0, -6.0)))) != design_hash(default)
    assert plain.skin == default.skin


@pytest.mark.parametrize("places", [[(5.0, 0.0)], [(-8.0, 0.0), (8.0, 0.0)], [(3.0, -6.0)]])
@pytest.mark.parametrize("size", [5.0, 2.5, 1.7])
def test_mesh_fills_the_skin_but_for_its_boards(tmp_path, places, size):
    mesh = skin_mesh(read_sensor(design(tmp_path, *places, extra=f"[mesh]\nsize_mm = {size}\n")))
    assert mesh.gradients[1].min() > 0
    assert mesh.gradients[1].sum() == pytest.approx(50 * 50 * 4 - len(places) * 10 * 10 * 1.7)
    for n, place in enumerate(places):
        own = mesh.nodes[mesh.board_of == n]
        assert (own.max(axis=0) + own.min(axis=0))[:2] / 2 == pytest.approx(place)
        assert own.max(axis=0) - own.min(axis=0) == pytest.approx((10, 10, 1.7))


@pytest.mark.parametrize(
    ("places", "extra", "words"),
    [
        ([(22.0, 0.0)], "", "'a0' at (22, 0) is not within the chamber"),
        ([(0.0, 0.0), (6.0, 3.0)], "", "'a0' and 'a1' overlap"),
        ([(5.0, 0.0)], "[board]\nthickness_mm = 3.9\n", "thickness_mm is 3.9 in a skin of 4"),
        ([(5.0, 0.0)], "[skin]\nfriction = 2.0\n", "friction is 2.0"),
        ([(5.0, 0.0)], "[skin]\nyoungs_modulus_mpa = 0.0\n", "must be positive"),
        ([(5.0, 0.0)], "[skin]\nheight_mm = [6.0, 5.0]\n", "must be positive and rise"),
        ([(5.0, 0.0)], "[skin]\nheight_mm = []\n", "give one level"),
        ([(5.0, 0.0)], "[mesh]\nsize_mm = 0.1\n", "size_mm is 0.1"),
        ([(5.0, 0.0)], "[mesh]\nlayers = 9\n", "layers is 9"),
    ],
)
def test_a_bad_design_is_one_line(tmp_path, places, extra, words):
    path = design(tmp_path, *places, extra=extra)
    with pytest.raises(InputError) as caught:
        check_design(read_sensor(path), str(path))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_pressure_beyond_the_skin_s_limit_is_refused(tmp_path, capsys):
    out = tmp_path / "a.npz"

    def small(skin: str) -> Path:
        path = design(tmp_path, (0.0, 0.0), extra=f"[skin]\n{skin}\n[mesh]\nsize_mm = 5.0\n")
        path.write_text(path.read_text().replace("[50.0, 50.0]", "[20.0, 20.0]"))
        return path

    path = small("effective_pressure_mpa = [0.1]")
    line = refused(capsys, "simulate", "--sensor", path, "--out", out)
    assert "effective_pressure_mpa 0.1 is beyond the skin's limit" in line
    assert not out.exists()
    with pytest.raises(InputError, match=r"height_mm 30 is beyond"):
        solve_atlas(read_sensor(small("height_mm = [30.0]")))


def test_coarse_is_the_same_design_of_larger_elements():
    sensor = read_sensor(DEFAULT_SENSOR)
    assert coarsened(sensor).mesh.size_mm > sensor.mesh.size_mm
    assert design_hash(coarsened(sensor)) == design_hash(sensor)


@pytest.mark.parametrize("values", [{"depth_mm": (0.5, 0.2)}, {"line_mm": 9.0}, {"steps_per_line": 1}])
def test_a_grid_that_continuation_does_not_bear_is_refused(values):
    with pytest.raises(ValueError, match=r"must|too long"):
        Grid(**values)

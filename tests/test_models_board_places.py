"""Board places: the bound is that of least squares, boards that fit, and a bare skin that tilts as one with boards."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import softslide
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.models.design.board_places import (
    GAP_MM,
    arrangement,
    best_places,
    information,
    lines_over,
    response_of,
)
from softslide.models.design.line_information import GAIN_SD, LINE_SPEED_MM_S, Line, places, slopes
from softslide.models.response_map.calibrate import MAP_VARIANCE
from softslide.models.response_map.from_atlas import DESIGN_NOISE_V, DESIGN_ZERO_V, SAMPLE_MM
from softslide.pipeline.atlas.atlas import read_atlas
from softslide.pipeline.atlas.bare_skin import TiltField, board_places, solve_tilts
from softslide.pipeline.recordings.folder import SAMPLE
from softslide.pipeline.sensor import read_sensor

BOARD_MM = (10.0, 10.0)
SENSOR = read_sensor(SAMPLE / "sensor.toml")
LINES = lines_over(SENSOR)
LARGE_MM = 6.0  # of the bump by which a contact tilts a place


@pytest.fixture(scope="module")
def field() -> TiltField:
    """Each place leans towards the contact, as the slope of a bump; without friction."""
    places = np.array([(x, y) for x in (-15.0, 0.0, 5.0, 15.0) for y in (-15.0, 0.0, 15.0)])
    grid = np.arange(-30.0, 30.1, 1.25)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    parts = np.zeros((3, len(grid), len(grid), len(places), 2))
    for p, (px, py) in enumerate(places):
        bump = 0.3 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * LARGE_MM**2))
        parts[0, :, :, p, 0], parts[0, :, :, p, 1] = bump * (x - px) / LARGE_MM, bump * (y - py) / LARGE_MM
    return TiltField(places, grid, grid, parts, 0.5)


@pytest.fixture(scope="module")
def known(field: TiltField) -> np.ndarray:
    return information(field, SENSOR, LINES)


def test_lines_cross_the_chamber_where_they_say() -> None:
    for line in LINES:
        direction, offset = line.direction_rad, line.offset_mm
        passed = places((0.0, 0.0), direction, offset, line.along_mm).T
        assert (np.abs(passed) < np.array(SENSOR.chamber_mm) / 2).all()
        assert passed @ np.array([-np.sin(direction), np.cos(direction)]) == pytest.approx(offset)
        assert np.linalg.norm(np.diff(passed, axis=0), axis=1) == pytest.approx(SAMPLE_MM)


def test_information_falls_with_the_noise_and_adds_up(known: np.ndarray, field: TiltField) -> None:
    eigenvalues = np.linalg.eigvalsh(known)
    assert (eigenvalues > -1e-6 * eigenvalues.max()).all()
    one, two = (arrangement(field.places_mm[:n], known[:n].sum(axis=0)).deviations for n in (4, 8))
    assert (two <= one + 1e-12).all()


def test_the_bound_is_the_scatter_of_least_squares(
    field: TiltField,
) -> None:
    """One line, one board next to it; noise drawn; offset and direction fitted with all else by Gauss-Newton."""

    response, board = response_of(field, SENSOR), 4
    line = Line(0.3, 3.0, np.arange(-24.0, 24.0, SAMPLE_MM))
    bound = arrangement(field.places_mm[[board]], information(field, SENSOR, [line])[board]).deviations[:, 0]
    variance = DESIGN_NOISE_V**2 * (LINE_SPEED_MM_S * Conditioning.block_s / SAMPLE_MM + MAP_VARIANCE)
    own = slopes(response, line)[:, 2 * board : 2 * board + 2]
    jacobian = np.concatenate([own, np.tile(np.eye(2), (len(own), 1, 1))], axis=-1).reshape(-1, 7)
    prior = np.diag([0, 0, 0, 0, GAIN_SD**-2, *[DESIGN_ZERO_V**-2] * 2])
    random = np.random.default_rng(0)
    draws = 4000
    unknown = np.zeros((draws, 7))
    unknown[:, 4:] = random.standard_normal((draws, 3)) * [GAIN_SD, DESIGN_ZERO_V, DESIGN_ZERO_V]
    seen = unknown @ jacobian.T + np.sqrt(variance) * random.standard_normal((draws, len(jacobian)))
    fitted = seen @ jacobian / variance @ np.linalg.inv(jacobian.T @ jacobian / variance + prior)
    scatter = (fitted - unknown).std(axis=0)[:3]
    assert scatter == pytest.approx(bound, rel=0.06)


def test_the_best_pair_is_the_best_of_all_that_fit(field: TiltField, known: np.ndarray) -> None:
    def criterion(chosen: tuple[int, ...]) -> float:
        deviations = arrangement(field.places_mm[list(chosen)], known[list(chosen)].sum(axis=0)).deviations
        return float(np.log(np.square(deviations).mean(axis=1)).sum())

    def fits(pair: tuple[int, ...]) -> bool:
        apart = np.abs(field.places_mm[pair[0]] - field.places_mm[pair[1]])
        return bool((apart >= np.array(BOARD_MM) + GAP_MM).any())

    pairs = [pair for pair in combinations(range(len(field.places_mm)), 2) if fits(pair)]
    found = best_places(field.places_mm, known, 2, BOARD_MM)
    index = [int(np.linalg.norm(field.places_mm - place, axis=1).argmin()) for place in found.places_mm]
    ranked = sorted(criterion(pair) for pair in pairs)
    # Exchanges end where no single one helps, which need not be the very best pair.
    assert criterion((index[0], index[1])) <= ranked[len(ranked) // 20]
    assert fits((index[0], index[1]))


def test_too_many_boards_are_refused(field: TiltField, known: np.ndarray) -> None:
    with pytest.raises(InputError, match="only 9 such boards fit"):
        best_places(field.places_mm, known, 10, (12.0, 12.0))


def test_places_leave_room_for_the_board() -> None:
    places = board_places(SENSOR)
    assert (np.abs(places) + 5.0 < 25.0).all()
    assert {tuple(p) for p in places} == {tuple(-p) for p in places}


@pytest.mark.long
def test_the_bare_skin_tilts_as_one_with_a_board() -> None:
    """Against the shipped atlas, which has the board: the same course, a few percent more of it."""
    field, atlas = solve_tilts(SENSOR, 7.0, 0.5), read_atlas()
    place = int(np.flatnonzero((field.places_mm == [5.0, 0.0]).all(axis=1))[0])
    x, y = (v.ravel() for v in np.meshgrid(field.x_mm, field.y_mm, indexing="ij"))
    for heading, part in ((0.0, 1), (90.0, 2)):
        solved = atlas.response(x, y, heading, 0.5, atlas.pressure_at(7.0))[:, 0, :2]
        bare = (field.parts[0] + field.parts[part])[:, :, place].reshape(-1, 2)
        for axis in range(2):
            one, other = solved[:, axis], bare[:, axis]
            assert np.corrcoef(one, other)[0, 1] > 0.99
            assert one @ other / (one @ one) == pytest.approx(1.04, abs=0.04)


@pytest.mark.long
def test_the_command_writes_sensors_to_go_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["design", "--sensor", SAMPLE / "sensor.toml", "--boards", 1, 2, "--out", tmp_path / "d"]
    assert softslide.main([str(word) for word in words]) == 0
    table = pd.read_csv(tmp_path / "d/design.csv")
    assert table["boards"].tolist() == ["as it is", "1 best", "2 best"]
    medians = table["distance_median_mm"]
    assert medians[0] >= medians[1] >= medians[2]
    assert [len(read_sensor(tmp_path / f"d/sensor-{n}.toml").accelerometers) for n in (1, 2)] == [1, 2]
    assert "Where to put the accelerometers" in (tmp_path / "d/design.html").read_text()
    assert "1 best" in capsys.readouterr().out

"""The article redone: its method on slides that follow its assumptions, its figures and claims on the sample."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from front_door import refused
from html_page import self_contained
from sample_folder import sample_folder

from softslide.experiments.article.answer_figures import PUBLISHED_CHI, published_minimum
from softslide.experiments.article.article import Article, article
from softslide.experiments.article.axis_slides import AxisSlides, edges_mm, read_axis_slides, seen_from_board
from softslide.experiments.article.method import BEST, PUBLISHED, Variant, fit_method
from softslide.experiments.article.skin_figures import pressure, static_output
from softslide.features.stream.conditioning import Conditioning
from softslide.features.vector.feature_vector import feature_names
from softslide.models.classical.interpolation import DIRECTIONS_DEG
from softslide.pipeline.atlas.atlas import DEFAULT_ATLAS, read_atlas
from softslide.pipeline.recordings.folder import SAMPLE, read_folder

EDGE_MM, EXTREMES_MM = -30.0, (20.0, 38.0)  # of X forward; the extremes past the edge


def drawn(n: int, seed: int, between_mm_s: tuple[float, float]) -> AxisSlides:
    """X forward slides, triggered 1 + 0.01 d^2 mm past the edge, whose extremes come at EXTREMES_MM past it and have
    the values -+ (0.3 - d / 100) V."""
    random = np.random.default_rng(seed)
    distances = random.uniform(2.0, 17.0, n)
    speeds, trigger_mm = random.uniform(*between_mm_s, n), 1.0 + 0.01 * distances**2
    features = dict.fromkeys(feature_names(1), np.zeros(n))
    features["elapsed_s"] = elapsed = (50.0 - trigger_mm) / speeds
    for name, way, sign in zip(("min", "max"), EXTREMES_MM, (-1.0, 1.0), strict=True):
        moment = (way - trigger_mm) / speeds
        features[f"a0_vx_{name}_v"] = sign * (0.3 - distances / 100)
        features[f"a0_vx_{name}_s"] = moment
        features[f"a0_vx_{name}_fraction"] = moment / elapsed
    ones = np.ones(n)
    features |= {"a0_vx_sign_first": -ones, "a0_vx_sign_last": ones, "a0_vy_max_v": 0.3 * ones}
    features |= {"a0_vy_sign_first": ones, "a0_vy_sign_last": ones}
    table = pd.DataFrame(
        {
            "recording": [f"r{k}" for k in range(n)],
            "split": "calibration",
            "fraction": 1.0,
            "kind": 0,
            "speed_mm_s": speeds,
            "offset_mm": distances,
            "distance_mm": distances,
            "elapsed_s": elapsed,
            "edge_mm": EDGE_MM,
            "along_mm": EDGE_MM + 50.0,
            "trigger_mm": trigger_mm,
        }
    )
    folder = seen_from_board(read_folder(SAMPLE))
    return AxisSlides(folder, Conditioning(), np.column_stack(list(features.values())), table)


def test_a_way_over_a_time_is_recovered_from_the_trigger_alone() -> None:
    """Where the extremes' places do not depend on the distance, v = a / t with t from the edge is exact."""
    variant = Variant("reciprocal", "reciprocal", edge=True, bounded=True)
    method = fit_method(drawn(60, 0, (0.5, 4.0)), variant)
    slides = drawn(30, 1, (0.6, 3.8))
    answers = method.predict(slides)
    assert answers["valid"].mean() > 0.8  # the rest is beyond the fitted range
    rows = answers["valid"].to_numpy()
    assert answers["speed_mm_s"][rows].to_numpy() == pytest.approx(slides.table["speed_mm_s"][rows], rel=1e-4)
    assert answers["offset_mm"][rows].to_numpy() == pytest.approx(slides.table["distance_mm"][rows], abs=1e-6)
    along = EDGE_MM + slides.table["trigger_mm"] + slides.table["speed_mm_s"] * slides.table["elapsed_s"]
    x_board = slides.folder.sensor.reference_mm[0]
    assert answers["x_mm"][rows].to_numpy() == pytest.approx(along[rows] + x_board, abs=0.01)


def test_counted_from_the_trigger_the_distance_spoils_the_speed() -> None:
    slides = drawn(80, 2, (1.5, 4.0))
    errors = {}
    for edge in (False, True):
        answers = fit_method(slides, Variant("", "reciprocal", edge=edge)).predict(slides)
        errors[edge] = (answers["speed_mm_s"] / slides.table["speed_mm_s"] - 1).abs().max()
    assert errors[True] < 0.1 * errors[False]


def test_at_its_best_it_is_silent_where_it_was_not_fitted() -> None:
    fitted = drawn(80, 3, (0.5, 4.0))
    slow, fast = drawn(20, 4, (0.4, 1.1)), drawn(20, 5, (5.0, 9.0))
    best, published = (fit_method(fitted, variant) for variant in (BEST, PUBLISHED))
    for slides in (slow, fast):
        assert not best.predict(slides)["valid"].any()
        assert published.predict(slides)["valid"].any()
    assert best.predict(drawn(20, 6, (1.8, 3.5)))["valid"].mean() > 0.8


def test_the_published_polynomial_turns_at_its_vertex() -> None:
    when, least = published_minimum()
    times = np.linspace(0, 60, 60001)
    speeds = np.polynomial.Polynomial(PUBLISHED_CHI)(times)
    assert least == pytest.approx(speeds.min(), abs=1e-6)
    assert when == pytest.approx(times[speeds.argmin()], abs=1e-3)
    assert least == pytest.approx(1.57, abs=0.005)


def test_distances_are_from_the_accelerometer() -> None:
    """Whatever the reference point is: a line's offset from the board is that of any of its points."""
    folder = read_folder(SAMPLE)
    manifest, (x, y) = folder.manifest, folder.sensor.reference_mm
    moved = replace(folder, sensor=replace(folder.sensor, reference_mm=(x - 3.0, y + 2.0)))
    angle = np.deg2rad(manifest["direction_deg"])
    offset = manifest["offset_mm"] - np.sin(angle) * 3.0 - np.cos(angle) * 2.0
    back = seen_from_board(replace(moved, manifest=manifest.assign(offset_mm=offset)))
    assert back.sensor.reference_mm == (x, y)
    assert back.manifest["offset_mm"].to_numpy() == pytest.approx(manifest["offset_mm"].to_numpy(), abs=1e-9)


def test_the_edge_is_where_the_motion_enters_the_chamber() -> None:
    board = np.array([5.0, 2.0])
    along = edges_mm(np.arange(4), (50.0, 40.0), (5.0, 2.0))
    for k, direction in enumerate(np.deg2rad(DIRECTIONS_DEG)):
        place = board + along[k] * np.array([np.cos(direction), np.sin(direction)])
        entered = place[k % 2]
        assert entered == pytest.approx((-25.0, -20.0, 25.0, 20.0)[k])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Article:
    return article(SAMPLE, tmp_path_factory.mktemp("article") / "out")


FIGURES = ("6", "9 to 11", *map(str, range(14, 27)))


def test_every_figure_is_there_with_the_numbers_behind_it(made: Article) -> None:
    assert tuple(s.figures for s in made.sections) == FIGURES
    for section in made.sections:
        assert section.panels or section.missing
        if len(section.table):
            written = pd.read_csv(made.page.parent / section.file)
            assert len(written) == len(section.table)
    claims = pd.read_csv(made.page.parent / "claims.csv")
    assert set(claims["verdict"]) <= {"holds", "in part", "does not hold", "not tested"}
    assert claims[["claim", "claimed", "measured", "why"]].notna().all(axis=None)


def test_what_is_known_not_to_hold_does_not(made: Article) -> None:
    claims = made.claims.set_index("claim")
    assert claims.loc["v = 0.008 t^2 - 0.4331 t + 7.4336 covers X-slides", "verdict"] == "does not hold"
    height = made.sections[1].table
    solved = height[height["source"] == "atlas"]
    ends = solved["formula_error_percent"].iloc[[0, -1]].to_numpy()
    assert ends == pytest.approx([38.0, 6.0], abs=1.5)


def test_pressures_and_lasers_of_the_folder_are_read(tmp_path: Path) -> None:
    """Half of the slides at another pressure, a laser's reading 10 % below what the formula gives for each."""
    manifest = pd.read_csv(sample_folder(tmp_path, "speed_mm_s > 0") / "manifest.csv")
    manifest.loc[::2, "pressure_mpa"] = 0.028
    manifest.to_csv(tmp_path / "manifest.csv", index=False)
    atlas = read_atlas(DEFAULT_ATLAS)
    without = static_output(atlas, read_folder(tmp_path))
    assert "o recording holds a laser's reading" in without.missing
    height = without.table["formula_mm"].iloc[-1] / 1.1
    manifest.assign(skin_height_mm=height).to_csv(tmp_path / "manifest.csv", index=False)
    section = static_output(atlas, read_folder(tmp_path))
    assert section.missing == ""
    recorded = section.table[section.table["source"] == "recordings"]
    assert set(recorded["pressure_mpa"]) == {0.028, 0.035}
    assert recorded["formula_error_percent"].mean() == pytest.approx(10.0, abs=2.0)
    slides, _ = read_axis_slides(read_folder(tmp_path))
    assert slides is not None
    role = pressure(atlas, read_folder(tmp_path), slides.whole)
    assert role.missing == ""
    assert "at 0.028 MPa" in role.here
    # A gauge's uneven readings of one pressure are no several ones.
    uneven_mpa = 0.035 * (1 + 0.018 * np.sin(np.arange(len(manifest))))
    manifest.assign(pressure_mpa=uneven_mpa).to_csv(tmp_path / "manifest.csv", index=False)
    slides, _ = read_axis_slides(read_folder(tmp_path))
    assert slides is not None
    assert "one pressure" in pressure(atlas, read_folder(tmp_path), slides.whole).missing


def test_the_best_variant_answers_less_and_errs_less(made: Article) -> None:
    table = pd.read_csv(made.page.parent / "variants.csv").set_index(["variant", "least_speed_mm_s"])
    published, best = (table.loc[(name, 0.0)] for name in ("as published", "at its best"))
    assert best["answered"] < published["answered"]
    assert best["speed_percent_max"] < published["speed_percent_max"]


def test_the_page_opens_without_a_network(made: Article) -> None:
    assert "Emulated bench recordings" in self_contained(made.page).words


def test_a_folder_without_axis_slides_still_gives_the_skins_figures(tmp_path: Path) -> None:
    made = article(sample_folder(tmp_path, "split == 'test-diagonal'"), tmp_path / "out")
    assert [s.figures for s in made.sections] == ["6", "9 to 11", "14 to 25", "26"]
    assert "No slide along x or y" in made.sections[2].missing


def test_other_sensors_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (SAMPLE / "sensor.toml").read_text()
    (tmp_path / "sensor.toml").write_text(text + 'kind = "magnetometer"\n')
    for place in ("manifest.csv", "slides"):
        (tmp_path / place).symlink_to(SAMPLE / place)
    assert "no accelerometers" in refused(
        capsys, "article", "--recordings", tmp_path, "--out", tmp_path / "out"
    )

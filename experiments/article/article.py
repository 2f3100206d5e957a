"""`softslide article`: the article's figures and claims on the recordings at hand, a page and its numbers."""

from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from experiments.article import (
    estimate_figures,
    interpolation_figures,
    place_figures,
    skin_figures,
    slide_figures,
)
from experiments.article.axis_slides import AxisSlides, read_axis_slides
from experiments.article.claims import claims_table, height_paragraph, polynomial_paragraph
from experiments.article.method import BEST, PUBLISHED, VARIANTS
from experiments.article.scoring import Scored, score_variant
from experiments.article.section import Section
from experiments.article.slide_figures import Whole, whole_slides
from experiments.derived_labels import derived
from experiments.evaluation.bounds import INFLATED_MM, read_bounds
from experiments.pages.page import render
from pipeline.atlas.library import atlas_of
from pipeline.recordings.folder import Folder, read_folder
from pipeline.recordings.taught import CALIBRATION
from pipeline.staging import staged

TEMPLATE = Path(__file__).parent / "article.html.j2"
# Errors in the table of variants: column of the scores, word, unit.
COMPARED = (
    ("speed_percent_error", "speed", "%"),
    ("offset_mm_error", "distance", "mm"),
    ("position_mm_error", "position", "mm"),
)


@dataclass(frozen=True)
class Article:
    """What `article` found. claims: as `claims.claims_table`. out: the page."""

    claims: pd.DataFrame
    page: Path
    sections: tuple[Section, ...]

    def lines(self) -> list[str]:
        """The claims, a line each."""
        return [f"{row.verdict}: {row.claim}: {row.measured}" for row in self.claims.itertuples()]


def article(recordings: Path, atlas_path: Path | None, out: Path) -> Article:
    """Writes `article.html`, `claims.csv`, `variants.csv` and `figure-NN.csv` to `out`, whole or not at all.

    Raises:
        InputError: the folder, a recording or the atlas is not what it should be, or the sensing elements are no
            accelerometers.
    """
    folder = derived(read_folder(recordings))
    slides, left_out = read_axis_slides(folder)
    sensor = folder.sensor
    atlas = atlas_of(sensor, atlas_path)
    whole = None if slides is None else whole_slides(slides)
    results = {} if slides is None else _scores(slides)
    published, best = results.get(PUBLISHED.name), results.get(BEST.name)
    sections = [
        skin_figures.simulation(atlas, sensor),
        skin_figures.static_output(atlas, folder),
        *_slide_sections(whole, results, sensor.chamber_mm, folder),
        skin_figures.pressure(atlas, folder),
    ]
    tables = {section.figures: section.table for section in sections}
    skin, pressure = tables["9 to 11"], tables["26"]
    assert skin is not None
    assert pressure is not None
    claims = claims_table(whole, published, best, read_bounds(), skin, pressure)
    variants = _variants(results)
    with staged(out) as scratch:
        for section in sections:
            if section.table is not None:
                section.table.to_csv(
                    scratch / section.file, index=False, float_format="%.6g", lineterminator="\n"
                )
        claims.to_csv(scratch / "claims.csv", index=False, lineterminator="\n")
        variants.to_csv(scratch / "variants.csv", index=False, float_format="%.6g", lineterminator="\n")
        text = render(
            TEMPLATE,
            sensor=sensor,
            recordings=len(folder),
            used=0 if whole is None else len(whole.table),
            left_out=left_out.lines(),
            sections=sections,
            claims=claims.to_dict("records"),
            variants=variants.to_dict("records"),
            on=published.on if published else "",
            polynomial=polynomial_paragraph(published, best),
            height=height_paragraph(skin),
        )
        (scratch / "article.html").write_text(text, encoding="utf-8")
    return Article(claims, out / "article.html", tuple(sections))


def _scores(slides: AxisSlides) -> dict[str, Scored]:
    """Every variant fitted and scored; none where the folder has no calibration slide of any kind."""
    taught = slides.table["split"].str.startswith(CALIBRATION)
    if not taught.any():
        return {}
    return {variant.name: score_variant(slides, variant) for variant in VARIANTS}


def _slide_sections(
    whole: Whole | None, results: dict[str, Scored], chamber_mm: tuple[float, float], folder: Folder
) -> list[Section]:
    """Figures 14 to 25, or why they cannot be made."""
    if whole is None or not results:
        why = (
            "No slide along x or y with its labels is in this folder."
            if whole is None
            else "No calibration slide along x or y is in this folder: there is nothing to fit the method to."
        )
        return [Section("14 to 25", "Slides, interpolation, areas, trajectories", "", missing=why)]
    published, best = results[PUBLISHED.name], results[BEST.name]
    shown = {PUBLISHED.name: published, BEST.name: best}
    board = folder.sensor.accelerometers[0]
    return [
        slide_figures.zones(whole),
        *(slide_figures.extremes(whole, axis) for axis in (0, 1)),
        *(interpolation_figures.interpolation(whole, published, best, kind) for kind in (0, 2, 1, 3)),
        *(estimate_figures.estimates(shown, axis) for axis in (0, 1)),
        place_figures.areas(best, chamber_mm, (board.x_mm, board.y_mm)),
        *(place_figures.trajectories(whole, best, axis) for axis in (0, 1)),
    ]


def _variants(results: dict[str, Scored]) -> pd.DataFrame:
    """Each variant's answers and errors on new slides of 0.5 to 4 mm/s, in all and of 1.5 mm/s and more."""
    rows = []
    for name, scored in results.items():
        for low in (0.0, 1.5):
            end = scored.new[scored.new["true_speed_mm_s"].between(low - 1e-9, 4.0 + 1e-9)]
            late = end[end["travelled_mm"].between(21.5, INFLATED_MM)]
            end = end[end["stroke_fraction"] == 1.0]
            row = {
                "variant": name,
                "least_speed_mm_s": low,
                "slides": len(end),
                "answered": int(end["valid"].sum()),
            }
            for column, word, unit in COMPARED:
                errors = (late if word == "position" else end)[column].dropna()
                name_of = f"{word}_{'percent' if unit == '%' else unit}"
                row |= {f"{name_of}_mean": errors.mean(), f"{name_of}_max": errors.max()}
            rows.append(row)
    return pd.DataFrame(rows)

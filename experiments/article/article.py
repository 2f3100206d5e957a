"""`softslide article`: the article's figures and claims on the recordings at hand, a page and its numbers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.article import answer_figures, skin_figures, slide_figures
from softslide.experiments.article.axis_slides import AxisSlides, read_axis_slides
from softslide.experiments.article.claims import claims_table
from softslide.experiments.article.method import BEST, LEAST_SPEED_MM_S, PUBLISHED, VARIANTS
from softslide.experiments.article.scoring import Scored, score_variant
from softslide.experiments.article.section import Section
from softslide.experiments.article.slide_figures import DELAY_MM
from softslide.experiments.derived_labels import derived
from softslide.experiments.evaluation.bounds import INFLATED_MM
from softslide.experiments.evaluation.scoring import summary
from softslide.experiments.evaluation.tables import error_table
from softslide.experiments.pages.page import render
from softslide.pipeline.atlas.library import atlas_of
from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.recordings.learned import CALIBRATION
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.staging import staged

TEMPLATE = Path(__file__).parent / "article.html.j2"
# Errors of variants.csv: quantity of the scores, and name.
COMPARED = {"speed_percent": "speed_percent", "offset_mm": "distance_mm", "position_mm": "position_mm"}


@dataclass(frozen=True)
class Article:
    """What `article` found. claims: as `claims.claims_table`. page: the file."""

    claims: pd.DataFrame
    page: Path
    sections: tuple[Section, ...]

    def lines(self) -> list[str]:
        """The claims, a line each."""
        return [f"{row.verdict}: {row.claim}: {row.measured}" for row in self.claims.itertuples()]


def article(recordings: str | Path, out: str | Path, atlas: str | Path | None = None) -> Article:
    """Writes `article.html`, `claims.csv`, `variants.csv` and `figure-NN.csv` to `out`, whole or not at all.

    atlas: of the design; None: as `pipeline.atlas.library.atlas_of` finds it.

    Raises:
        InputError: the folder, a recording or the atlas is not what it should be, or the sensing elements are not
            accelerometers.
    """
    out, folder = Path(out), derived(read_folder(recordings))
    slides, left_out = read_axis_slides(folder)
    sensor, solved = folder.sensor, atlas_of(folder.sensor, atlas)
    whole = None if slides is None else slides.whole
    results = _scores(slides)
    skin, pressure = skin_figures.static_output(solved, folder), skin_figures.pressure(solved, folder, whole)
    slide_sections = _slide_sections(whole, results, sensor)
    sections = (skin_figures.simulation(solved, sensor), skin, *slide_sections, pressure)
    claims, errors = claims_table(whole, results, skin.table, pressure.table), _errors(results)
    tables = {section.file: section.table for section in sections if len(section.table)}
    tables |= {"claims.csv": claims, "variants.csv": _variants(errors)}
    with staged(out) as scratch:
        for name, table in tables.items():
            table.to_csv(scratch / name, index=False, float_format="%.6g", lineterminator="\n")
        text = render(
            TEMPLATE,
            sensor=sensor,
            recordings=len(folder),
            used=0 if whole is None else len(whole.table),
            left_out=left_out,
            sections=sections,
            claims=claims.to_dict("records"),
            errors=error_table(
                {f"{name}, {max(low, 0.5):g} to 4 mm/s": row for (name, low), row in errors.items()}
            ),
            on=results[PUBLISHED.name].on if results else "",
        )
        (scratch / "article.html").write_text(text, encoding="utf-8")
    return Article(claims, out / "article.html", sections)


def _scores(slides: AxisSlides | None) -> dict[str, Scored]:
    """Every variant fitted and scored; empty where the folder has no calibration slide along an axis."""
    if slides is None or not slides.table["split"].str.startswith(CALIBRATION).any():
        return {}
    return {variant.name: score_variant(slides, variant) for variant in VARIANTS}


def _slide_sections(whole: AxisSlides | None, results: dict[str, Scored], sensor: Sensor) -> list[Section]:
    """Figures 14 to 25, or why they cannot be made."""
    if whole is None or not results:
        of = "slide along x or y with its labels" if whole is None else "calibration slide along x or y"
        why = f"No {of} is in this folder: there is nothing to fit the method to."
        return [Section("14 to 25", "Slides, interpolation, areas, trajectories", "", missing=why)]
    best = results[BEST.name]
    shown = {name: results[name] for name in (PUBLISHED.name, BEST.name)}
    return [
        slide_figures.zones(whole),
        *(slide_figures.extremes(whole, axis) for axis in (0, 1)),
        *(answer_figures.interpolation(whole, best.method, kind) for kind in (0, 2, 1, 3)),
        *(answer_figures.estimates(shown, axis) for axis in (0, 1)),
        answer_figures.areas(best, sensor),
        *(answer_figures.trajectories(whole, best, sensor, axis) for axis in (0, 1)),
    ]


def _errors(results: dict[str, Scored]) -> dict[tuple[str, float], dict[str, Any]]:
    """By variant and least speed, mm/s, the `scoring.summary` of its answers on new slides of up to 4 mm/s: at the end
    of the stroke, but of the position once the article's delays are over."""
    found = {}
    for name, scored in results.items():
        for low in (0.0, LEAST_SPEED_MM_S):
            every = scored.new[scored.new["true_speed_mm_s"].between(low - 1e-9, 4.0 + 1e-9)]
            late = every[every["travelled_mm"].between(max(DELAY_MM), INFLATED_MM)]
            end = every[every["stroke_fraction"] == 1.0]
            found[name, low] = summary(end) | {"position_mm": summary(late)["position_mm"]}
    return found


def _variants(errors: dict[tuple[str, float], dict[str, Any]]) -> pd.DataFrame:
    """The rows of variants.csv."""
    rows = []
    for (name, low), of in errors.items():
        row = {"variant": name, "least_speed_mm_s": low}
        row |= {"slides": of["recordings"], "answered": of["speed_percent"]["n"]}
        for quantity, error in COMPARED.items():
            row |= {f"{error}_{kind}": of[quantity].get(kind, np.nan) for kind in ("mean", "max")}
        rows.append(row)
    return pd.DataFrame(rows)

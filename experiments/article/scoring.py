"""Scores of the article's method, on the slides that it was fitted to and on slides that it was not."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from softslide.experiments.article.axis_slides import AxisSlides
from softslide.experiments.article.method import Method, Variant, fit_method
from softslide.experiments.evaluation.scoring import score
from softslide.pipeline.recordings.learned import CALIBRATION

FOLDS = 5
_LINE_MM = 0.5  # lines this close count as one


@dataclass(frozen=True)
class Scored:
    """A variant on a folder. method: fitted to all calibration slides. fitted, new: rows of `evaluation.scoring.score`
    for slides that it was fitted to, as in the article, and for slides along other lines; on: what the latter are."""

    method: Method
    fitted: pd.DataFrame
    new: pd.DataFrame
    on: str


def score_variant(slides: AxisSlides, variant: Variant) -> Scored:
    """Fits a variant to the calibration slides and scores it.

    Where the folder has test slides, these are the new ones; else each line in turn is left out of the fit.
    """
    fitted_to = slides.table["split"].str.startswith(CALIBRATION).to_numpy()
    tested = slides.table["split"].str.startswith("test").to_numpy()
    method = fit_method(slides[fitted_to].whole, variant)
    fitted = scored(method, slides[fitted_to])
    if tested.any():
        return Scored(method, fitted, scored(method, slides[tested]), "test slides")
    line, parts = _lines(slides.table), []
    for fold in range(FOLDS):
        out = fitted_to & (line % FOLDS == fold)
        if out.any() and (fitted_to & ~out).any():
            parts.append(scored(fit_method(slides[fitted_to & ~out].whole, variant), slides[out]))
    return Scored(method, fitted, pd.concat(parts, ignore_index=True), "lines left out of the fit")


def scored(method: Method, slides: AxisSlides) -> pd.DataFrame:
    """The method's answers on the slides, with their errors, kind and distance."""
    folder = slides.folder
    table = score(method.predict(slides), folder.manifest, folder.sensor)
    return table.assign(
        kind=slides.table["kind"].to_numpy(), distance_mm=slides.table["distance_mm"].to_numpy()
    )


def at_end(scored: pd.DataFrame, axis: int) -> pd.DataFrame:
    """The slides along one axis (0 x, 1 y) at the end of their stroke, up to 4 mm/s, with their `distance`, mm."""
    end = scored[(scored["stroke_fraction"] == 1.0) & (scored["kind"] % 2 == axis)]
    end = end[end["true_speed_mm_s"] <= 4.0 + 1e-9]
    return end.assign(distance=end["offset_mm"].abs())


def _lines(table: pd.DataFrame) -> np.ndarray:
    """(n,) number of each window's line among those of its axis, by its place."""
    place = np.where(table["kind"].isin((0, 3)), 1, -1) * table["offset_mm"]
    line = (place / _LINE_MM).round().astype(int)
    return line.groupby(table["kind"] % 2).rank(method="dense").astype(int).to_numpy()

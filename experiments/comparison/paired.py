"""Models side by side: differences of their errors on the same slides, with confidence intervals over lines.

A slide that is hard for one model is hard for all, so that differences slide by slide show more than two means. Slides
along one line are alike: a line's mean counts once.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from softslide.experiments.evaluation.scoring import WORDS
from softslide.models.held_out import line_folds

CONFIDENCE = 0.95
LEAST_LINES = 3  # fewer show nothing of the spread between lines
COLUMNS = (
    *("split", "model", "against", "quantity", "lines", "recordings", "difference", "low", "high"),
    *("valid_alone", "against_alone"),
)


def paired(scored: Mapping[str, pd.DataFrame], against: str) -> pd.DataFrame:
    """For each split, model and quantity the mean difference of the absolute errors at the end of the stroke, model
    less `against`, with its 95 % confidence interval (paired t-test over lines, Student 1908); a row each, of COLUMNS.

    scored: by model, from `scoring.score`, of the same recordings. Pairs are recordings that both models estimate;
    valid_alone, against_alone: how many one of the two alone does. low, high: NaN with fewer than LEAST_LINES lines.
    """
    ends = {m: rows[rows["stroke_fraction"] == 1.0].set_index("recording") for m, rows in scored.items()}
    rows = []
    for split, other in ends.pop(against).groupby("split"):
        for model, end in ends.items():
            for quantity in WORDS:
                mine, others = (table[f"{quantity}_error"] for table in (end.loc[other.index], other))
                head = {"split": split, "model": model, "against": against, "quantity": quantity}
                rows.append(head | _difference(mine, others, other))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _difference(mine: pd.Series, other: pd.Series, labels: pd.DataFrame) -> dict[str, Any]:
    """mine, other: absolute errors by recording, NaN where nothing is estimated; labels: `true_` columns."""
    both = mine.notna() & other.notna()
    difference = (mine - other)[both]
    direction, offset = (
        labels.loc[difference.index, ["true_direction_deg", "true_offset_mm"]].to_numpy(float).T
    )
    line = line_folds(direction, offset, len(difference) + 1)
    by_line = difference.groupby(line).mean().to_numpy()
    mean, low, high = interval(by_line)
    return {
        "lines": len(by_line),
        "recordings": len(difference),
        "difference": mean,
        "low": low,
        "high": high,
        "valid_alone": int((mine.notna() & other.isna()).sum()),
        "against_alone": int((mine.isna() & other.notna()).sum()),
    }


def interval(values: np.ndarray) -> tuple[float, float, float]:
    """The mean of independent values and its two-sided 95 % confidence interval; NaN where they are too few for it."""
    if len(values) < LEAST_LINES:
        return float(values.mean()) if len(values) else np.nan, np.nan, np.nan
    mean = float(values.mean())
    half = float(stdtrit(len(values) - 1, (1 + CONFIDENCE) / 2) * values.std(ddof=1) / np.sqrt(len(values)))
    return mean, mean - half, mean + half

"""comparison.html: the models side by side, by differences of their errors on the same slides."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from softslide.experiments.evaluation.figures import along_the_stroke
from softslide.experiments.evaluation.scoring import QUANTITIES, WORDS, summary
from softslide.experiments.evaluation.tables import error_table
from softslide.experiments.pages.figures import Panel, intervals
from softslide.experiments.pages.page import number


def section(folder: str, scored: Mapping[str, pd.DataFrame], pairs: pd.DataFrame) -> dict[str, Any]:
    """One folder's part of the page, as the template takes it. scored: by model. pairs: of `paired.paired`."""
    table = pd.concat([rows.assign(model=model) for model, rows in scored.items()], ignore_index=True)
    end = table[table["stroke_fraction"] == 1.0]
    compared = pairs.groupby(["split", "model"], sort=False)
    return {
        "folder": folder,
        "against": None if pairs.empty else pairs["against"].iloc[0],
        "panels": [] if pairs.empty else [_differences(pairs, quantity) for quantity in WORDS],
        "over_stroke": [
            (split, along_the_stroke(rows, "model", f", {split}")) for split, rows in table.groupby("split")
        ],
        "differences": {f"{split}, {model}": _compared(part) for (split, model), part in compared},
        "errors": error_table(
            {
                f"{split}, {model}": summary(rows)
                for (split, model), rows in end.groupby(["split", "model"], sort=False)
            }
        ),
    }


def _compared(pairs: pd.DataFrame) -> dict[str, dict[str, str]]:
    """A row of the table of differences: of one model on one split."""
    first, cells = pairs.iloc[0], {}
    for row in pairs.to_dict("records"):
        interval = f"[{number(row['low'], 2)}, {number(row['high'], 2)}]"
        shown = {"difference": number(row["difference"], 2), "interval": interval, "error": verdict(row)}
        cells[f"{WORDS[row['quantity']]}, {QUANTITIES[row['quantity']]}"] = shown
    counts = {"": {"lines": str(first["lines"]), "recordings": str(first["recordings"])}}
    alone = {"it": str(first["valid_alone"]), first["against"]: str(first["against_alone"])}
    return counts | cells | {"alone": alone}


def verdict(row: Mapping[Any, Any]) -> str:
    """Of a row of paired.csv: errors "smaller" or "larger" than the other's, "" where the interval holds zero, "too
    few" lines for one."""
    if np.isnan(row["low"]):
        return "too few"
    return "smaller" if row["high"] < 0 else "larger" if row["low"] > 0 else ""


def _differences(pairs: pd.DataFrame, quantity: str) -> Panel:
    """A row a model, in it a dot with its interval a split; linear about zero, logarithmic beyond."""
    rows = pairs[pairs["quantity"] == quantity].rename(columns={"difference": "middle"})
    word, unit, against = WORDS[quantity], QUANTITIES[quantity], rows["against"].iloc[0]
    labels = (f"{word}: right of zero is worse", f"error less that of {against}, {unit}")
    text = (
        f"Mean difference of the {word} error ({unit}), each model less {against} on the same slides, by split; "
        "bars: 95 % confidence intervals over lines. A bar that does not reach zero: the two differ."
    )
    return intervals(rows, "model", "split", labels, text, line=0.0, log=True)

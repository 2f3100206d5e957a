"""docs/format.md says what the code does: its tables against the code's columns, fields and exit statuses."""

import ast
import inspect
import re
import textwrap
from dataclasses import fields
from pathlib import Path

import pandas as pd

import softslide
from softslide.experiments.evaluation import tracks
from softslide.experiments.evaluation.readout import COLUMNS
from softslide.features.card import Card
from softslide.features.estimate import RECORDED, Reason
from softslide.pipeline.recordings import truth
from softslide.pipeline.recordings.manifest import LABELS, REQUIRED

TEXT = (Path(__file__).parents[1] / "docs" / "format.md").read_text(encoding="utf-8")


def first_column(title: str) -> tuple[str, ...]:
    """The names in the first column of the table whose heading begins with the title."""
    _, rows = TEXT.split(f"| {title} |")
    cells = re.findall(r"^\| (`[^|]+`) \|", rows.partition("\n\n")[0], re.MULTILINE)
    return tuple(name for cell in cells for name in re.findall(r"`([^`]+)`", cell))


def test_the_tables_list_the_codes_columns_and_fields_in_order() -> None:
    assert first_column("manifest column") == (*REQUIRED, *LABELS)
    assert first_column("prediction column") == COLUMNS
    assert first_column("truth column") == truth.COLUMNS
    assert first_column("estimate field") == RECORDED
    assert first_column("reason") == tuple(str(reason) for reason in Reason if reason)
    assert first_column("card field") == tuple(field.name for field in fields(Card))


def test_the_track_metrics_are_those_that_a_summary_holds() -> None:
    _, rows = TEXT.split("| track metric |")
    cells = re.findall(r"^\| (`[^|]+) \|", rows.partition("\n\n")[0], re.MULTILINE)
    listed = [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]
    stream = [{"time_s": k / 50, "state": "slide", "valid": False} for k in range(5)]
    still = pd.DataFrame([[k / 100, 0, 0, 0, 0, 1, 0] for k in range(20)], columns=list(truth.COLUMNS))
    summary = tracks.summarize([tracks.judge(tracks.estimate_table(stream), still, (0.0, 0.0))])
    assert sorted(listed) == sorted(summary)


def test_the_exit_statuses_are_those_that_the_command_returns() -> None:
    """Every whole number in `main` is a status that it returns; what each means, the tests of the command say."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(softslide.main)))
    returned = [node for node in ast.walk(tree) if isinstance(node, ast.Return) and node.value is not None]
    numbers = {
        n.value
        for statement in returned
        for n in ast.walk(statement)
        if isinstance(n, ast.Constant) and isinstance(n.value, int)
    }
    assert first_column("exit status") == tuple(map(str, sorted(numbers)))

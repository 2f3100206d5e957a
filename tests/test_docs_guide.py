"""docs/guide.md: its commands run in their order on a few recordings of the sample."""

import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import chdir, redirect_stdout
from importlib import import_module
from importlib.util import find_spec
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from joblib.externals.loky import get_reusable_executor
from small_bundle import write_small_bundle

import softslide
from softslide.command_line import parser
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.sensor import read_sensor

TEXT = (Path(__file__).parents[1] / "docs" / "guide.md").read_text(encoding="utf-8")
# Of the sample's slides: quick ones are short. Fewer do for commands that fit nothing.
FASTEST, FITTED = 6, 36
# What takes half a minute and more, and what needs a trained bundle: in the long test.
SLOW = ("design", "plan", "train", "export", "python", "article")
# What waits for a port, or serves until it is stopped; and where it runs.
ELSEWHERE = {
    "record": "test_experiments_record.py",
    "serve --model my-model --source udp": "test_serve_live.py, test_serve_page.py",
}


def commands() -> list[str]:
    """The guide's commands in order, without the name of the program; studies begin with python."""
    return re.findall(r"^    (?:softslide )?((?<=softslide ).+|python -m .+)$", TEXT, re.MULTILINE)


def begins(command: str, names: Iterable[str]) -> bool:
    return any(command.startswith(name) for name in names)


def study(words: list[str]) -> int:
    """`python -m MODULE WORDS...`."""
    return import_module(words[2]).main(words[3:])


def run(command: str) -> int:
    """One line of a shell: the command, its standard output in a file where it says so."""
    words = shlex.split(command)
    out = StringIO()
    target = None
    if ">" in words:
        target = Path(words[words.index(">") + 1])
        words = words[: words.index(">")]
    with redirect_stdout(out):
        status = study(words) if words[0] == "python" else softslide.main(words)
    if target:
        target.write_text(out.getvalue(), encoding="utf-8")
    return status


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder to work in, with its own store of runs."""
    # Worker processes of earlier tests have another current folder.
    get_reusable_executor().shutdown(wait=True)
    monkeypatch.setenv("MLFLOW_TRACKING_URI", f"sqlite:///{tmp_path / 'mlflow.db'}")
    with chdir(tmp_path):
        yield tmp_path


def lay_out(bench: Path, slides: int) -> None:
    """What the guide's commands find: so many recordings, a lab's CSV files, a slide."""
    sample = read_folder(SAMPLE)
    for place in ("my-recordings", "lab"):
        (bench / place).mkdir()
    for place in ("sensor.toml", "slides"):
        (bench / "my-recordings" / place).symlink_to(SAMPLE / place)
    table = pd.read_csv(SAMPLE / "manifest.csv").sort_values("speed_mm_s").tail(slides)
    table.sort_index().to_csv(bench / "my-recordings/manifest.csv", index=False)
    name = str(table["recording"].iloc[-1])
    recording = sample.load(name)
    columns = pd.DataFrame(recording.volts, columns=list(sample.sensor.channels))
    columns.insert(0, "time_s", recording.time_s)
    columns.to_csv(bench / "slide.csv", index=False)
    # As the map's template has them.
    columns.columns = ["time_s", "ai0", "ai1", "ai2"]
    columns.to_csv(bench / "lab" / f"{name}.csv", index=False)


def test_every_command_is_one_that_the_program_has() -> None:
    found = commands()
    assert len(found) > 12
    for command in found:
        words = shlex.split(command)
        if words[0] == "python":
            assert find_spec(words[2])
        else:
            parser().parse_args(words[: words.index(">")] if ">" in words else words)
    for name, where in ELSEWHERE.items():
        assert any(begins(command, [name]) for command in found)
        for file in where.split(", "):
            assert (Path(__file__).parent / file).exists()


def follow(chosen: Iterable[str]) -> None:
    """Runs the commands in order."""
    for command in chosen:
        status = run(command)
        # A bound of the article that is missed gives 1: the recordings are few.
        assert status == 0 or (status == 1 and command.startswith("evaluate")), command


def test_the_guide_s_commands_run(bench: Path) -> None:
    """All but the slow ones; the model that they read out is a product of matrices."""
    lay_out(bench, FASTEST)
    write_small_bundle(bench / "first-model", read_folder(SAMPLE).sensor)
    chosen = [c for c in commands() if not begins(c, (*SLOW, *ELSEWHERE))]
    assert len(chosen) == 8
    follow(chosen)
    assert read_folder(bench / "imported").manifest["split"].tolist() == ["calibration"]
    assert "be trusted on" in (bench / "results/report.html").read_text()
    assert (bench / "coverage.svg").stat().st_size > 1000


@pytest.mark.long
def test_the_guide_s_slow_commands_run(bench: Path) -> None:
    lay_out(bench, FITTED)
    follow([c for c in commands() if not begins(c, ELSEWHERE)])
    assert len(read_sensor(bench / "design/sensor-2.toml").accelerometers) == 2
    assert len(pd.read_csv(bench / "plan.csv")) == 24 + 12
    assert (bench / "my-model-c/model.c").exists()
    assert (bench / "article/article.html").exists()

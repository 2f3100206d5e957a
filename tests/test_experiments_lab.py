"""`make lab`: a stage, a skin and everything after it, without hardware."""

import json
import os
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from softslide.experiments.studies.lab.skin import FAULT_AFTER_MM, Ball
from softslide.pipeline.recordings.folder import read_folder

DOCS = Path(__file__).parents[1] / "docs"
ORIGIN = [110.0, 95.0, 31.5]


def moved(ball: Ball, begin_s: float, *places: tuple[float, float, float]) -> None:
    """Adds moves of 1 s from place to place over the skin."""
    for n, (begin, end) in enumerate(pairwise(places)):
        at, to = (np.array(place) + ORIGIN for place in (begin, end))
        ball.add({"at_s": begin_s + n, "took_s": 1.0, "from": at.tolist(), "to": to.tolist()})


def test_the_ball_is_where_the_moves_are_whatever_the_packets() -> None:
    moments = np.arange(0.0, 5.0, 0.01)
    all_at_once, in_packets = (Ball(ORIGIN, [0.0, 0.0, 0.0]) for _ in range(2))
    for ball in (all_at_once, in_packets):
        moved(ball, 1.0, (0, 0, 20), (-30, 5, 20), (-30, 5, -0.5), (30, 5, -0.5))
    whole = all_at_once.places(moments)
    assert whole[moments > 1.0][0] == pytest.approx([-0.3, 0.05, 20], abs=1e-6)
    assert whole[moments > 3.5][0] == pytest.approx([0.6, 5.0, -0.5], abs=1e-6)
    assert whole[-1] == pytest.approx([30, 5, -0.5])
    pieces = [in_packets.places(part) for part in np.split(moments, range(7, len(moments), 7))]
    assert np.concatenate(pieces) == pytest.approx(whole)


def test_a_wrong_corner_turns_and_shifts_what_the_skin_feels() -> None:
    ball = Ball(ORIGIN, [0.4, -0.3, 90.0])
    moved(ball, 0.0, (0, 0, 0), (10, 0, 0))
    assert ball.places(np.array([2.0]))[0] == pytest.approx([0.4, 9.7, 0.0])


def test_lost_steps_and_a_stalled_axis_begin_in_the_middle() -> None:
    ball = Ball(ORIGIN, [0.0, 0.0, 0.0], lost_mm=1.0, stalled=True)
    moved(ball, 0.0, (0, 0, 0), (FAULT_AFTER_MM, 0, 0), (FAULT_AFTER_MM, 50, 0))
    assert ball.places(np.array([0.5]))[0] == pytest.approx([FAULT_AFTER_MM / 2, 0, 0])
    ball.places(np.array([1.0]))
    assert ball.places(np.array([2.0]))[0] == pytest.approx([FAULT_AFTER_MM - 1, 0, 0])


@pytest.mark.long
def test_a_printer_records_what_a_model_learns_from(tmp_path: Path) -> None:
    """OctoPrint's virtual printer, which others wrote, in an environment of its own; with lines that arrive damaged.

    Then a ball that MuJoCo moves over the same skin.
    """
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True, timeout=300)
    python = tmp_path / "env/bin/python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "OctoPrint==1.11.8"], check=True, timeout=1800)
    call = [sys.executable, "-m", "softslide.experiments.studies.lab", "--printer", python]
    call += ["--out", tmp_path / "lab", "--slides", "8", "--tests", "3", "--paths", "1", "--fault", "resend"]
    subprocess.run([*call, "--json", tmp_path / "found.json"], check=True, timeout=3600)
    folder = read_folder(tmp_path / "lab/printer")
    assert sorted(folder.manifest["split"].unique()) == ["calibration", "test", "track-line"]
    assert len(folder) == 12
    bundle = tmp_path / "lab/printer/bundle"
    slide = [sys.executable, DOCS / "examples" / "mujoco_ball.py", "--model", bundle, "--seed", "0"]
    drawn = os.environ | {"MPLBACKEND": "svg"}
    said = subprocess.run(slide, check=True, capture_output=True, text=True, timeout=600, env=drawn).stdout
    errors = re.search(r"place ([\d.]+) mm, direction ([\d.]+) deg", said)
    assert errors is not None, said
    assert float(errors[1]) < 2.0
    assert float(errors[2]) < 4.0
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["printer"]["valid"] == 1.0
    assert found["printer"]["direction_deg_mean"] < 1.0
    assert found["printer"]["offset_mm_mean"] < 0.5

"""The library as docs/api.md shows it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import softslide
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import SAMPLE, read_folder

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")


@pytest.mark.long
def test_the_example_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/api.md", "exec"), {"__name__": "example"})
    first, *bounds = capsys.readouterr().out.splitlines()
    row = read_folder(SAMPLE).manifest.loc["a0120"]
    direction, speed, offset = (float(part.split()[0]) for part in first.split(","))
    assert abs((direction - row["direction_deg"] + 180) % 360 - 180) < 5
    assert abs(speed / row["speed_mm_s"] - 1) < 0.08
    assert abs(offset - row["offset_mm"]) < 1.5
    assert any(line.startswith("direction") for line in bounds)


def test_every_name_offered_is_described_and_there() -> None:
    described = set(re.findall(r"`(\w+)`", " ".join(re.findall(r"^\| (.+?) \|", PAGE, re.MULTILINE))))
    assert described == set(softslide.OFFERED)
    for name in softslide.OFFERED:
        assert getattr(softslide, name) is not None
        assert name in dir(softslide)
    with pytest.raises(AttributeError, match="it offers"):
        getattr(softslide, "nothing")  # noqa: B009


def test_the_import_costs_no_room() -> None:
    program = "import sys, softslide; print({'numpy', 'pandas', 'torch', 'onnxruntime'} & set(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout == "set()\n"


def test_texts_are_taken_for_paths() -> None:
    for call in (
        lambda: softslide.Localizer.load("no-such"),
        lambda: softslide.read_folder("no-such"),
        lambda: softslide.read_sensor("no-such"),
        lambda: next(softslide.predict("no-such", ["a.csv"])),
        lambda: softslide.train("no-such", "out", track=False),
        lambda: softslide.evaluate("no-such", str(SAMPLE), None, "out", track=False),
    ):
        with pytest.raises(InputError, match="no-such"):
            call()

"""The library as docs/api.md shows it."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import softslide
from softslide.command_line import parser
from softslide.features.errors import InputError
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.serve.stream.live import serve

ROOT = Path(__file__).parents[1]
SUBPARSERS = next(a for a in parser()._actions if a.dest == "command").choices
FUNCTIONS = {"import": "import_recordings"}
# Of the command alone: how results are shown, exit statuses, templates, and what a function of its own does.
OWN = {
    "check": {"json"},
    "evaluate": {"allow_untested"},
    "import": {"guess", "map_template", "sensor_template"},
    "predict": {"presses", "atlas", "map"},
    "train": {"config_template", "from_run"},
}
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
    assert described == {*softslide.OFFERED, "serve"}
    for name in (*softslide.OFFERED, *softslide.ROOMS):
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


@pytest.mark.parametrize("command", sorted(SUBPARSERS))
def test_every_command_is_a_function_that_takes_its_options(command: str) -> None:
    function = (
        serve if command == "serve" else getattr(softslide, FUNCTIONS.get(command, command.replace("-", "_")))
    )
    named = {action.dest: action for action in SUBPARSERS[command]._actions}
    given = named.keys() - {"help"} - OWN.get(command, set())
    parameters = inspect.signature(function).parameters
    assert given <= set(parameters)
    for name in given:
        if named[name].default and not named[name].required:
            kept = parameters[name].default
            assert named[name].default == (list(kept) if isinstance(kept, tuple) else kept), name
    assert inspect.getdoc(function)


def test_the_room_that_serves_is_called(
    bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "".join(f"{n / 1000},1.65,1.65,2.45\n" for n in range(200))
    (tmp_path / "rest.csv").write_text("time_s,a0_vx,a0_vy,a0_vz\n" + rows)
    assert softslide.serve(bundle, str(tmp_path / "rest.csv"), fast=True) == 10
    assert len(capsys.readouterr().out.splitlines()) == 10
    assert softslide.serve.localizer.Localizer is softslide.Localizer

"""The command as a user meets it: help, exit statuses, and what runs with the base install alone."""

import importlib
import json
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from small_bundle import write_small_bundle

import softslide
from pipeline.recordings.folder import SAMPLE, read_folder

HERE = Path(__file__).parents[1]
# What a device does not have: everything but the base install, numpy and onnxruntime.
HEAVY = (
    *("torch", "sklearn", "mlflow", "scipy", "pandas", "numba", "pandera", "pyarrow", "onnx", "skl2onnx"),
    *("joblib", "dask", "matplotlib", "jinja2", "tqdm", "tomli_w", "h5py", "optuna"),
    *("fastapi", "uvicorn", "websockets", "serial"),
)
COMMANDS = sorted(
    next(a for a in softslide._parser()._actions if a.dest == "command").choices  # type: ignore[arg-type]
)


def test_packages_are_those_of_this_tree() -> None:
    rooms = [path.parent.name for path in HERE.glob("*/__init__.py")]
    assert {"features", "pipeline", "models", "experiments", "serve"} <= set(rooms)
    for room in rooms:
        assert Path(importlib.import_module(room).__file__ or "").parent == HERE / room


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own where importing HEAVY fails, as on a device."""
    script = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {HEAVY!r}:
            raise ImportError(name + " is not on this device")

sys.meta_path.insert(0, Absent())
sys.path.insert(0, {str(HERE)!r})
import softslide
sys.exit(softslide.main(sys.argv[1:]))
"""
    return subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], capture_output=True, text=True
    )


def test_the_runtime_imports_numpy_and_onnxruntime_alone() -> None:
    modules = [
        ".".join(path.relative_to(HERE).with_suffix("").parts)
        for room in ("features", "serve")
        for path in sorted((HERE / room).rglob("*.py"))
    ]
    assert "serve.localizer" in modules
    script = f"import importlib, sys\nfor name in {modules!r}: importlib.import_module(name)\n" + (
        f"sys.exit(', '.join(set({HEAVY!r}) & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=HERE)
    assert done.stderr.strip() == ""
    assert done.returncode == 0


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle, and one sample recording as Parquet and as CSV."""
    root = tmp_path_factory.mktemp("device")
    folder = read_folder(SAMPLE)
    write_small_bundle(root / "bundle", folder.sensor)
    fastest = str(folder.manifest["speed_mm_s"].idxmax())
    recording = folder.load(fastest)
    table = pd.DataFrame(recording.volts, columns=list(folder.sensor.channels))
    table.insert(0, "time_s", recording.time_s)
    table.to_csv(root / "slide.csv", index=False)
    table.to_parquet(root / "slide.parquet")
    return root


def test_a_device_predicts_from_csv(device: Path) -> None:
    done = run("predict", "--model", device / "bundle", device / "slide.csv", device / "slide.csv")
    assert done.returncode == 0, done.stderr
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert first == second
    assert first["recording"] == "slide"
    assert first["direction_deg"] == pytest.approx(30.0, abs=1e-4)
    assert first["depth_mm"] is None
    assert first["valid"] is True


def test_parquet_says_which_extra_it_needs(device: Path) -> None:
    done = run("predict", "--model", device / "bundle", device / "slide.parquet")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "softslide[io]" in done.stderr


def test_parquet_and_csv_predict_the_same(device: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(device / "slide.csv"), str(device / "slide.parquet")]
    assert softslide.main(["predict", "--model", str(device / "bundle"), *files]) == 0
    csv, parquet = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert csv.pop("file") != parquet.pop("file")
    assert csv == parquet


def spoil(lines: list[str], row: int, cell: int, text: str) -> list[str]:
    cells = lines[row].split(",")
    cells[cell] = text
    return [*lines[:row], ",".join(cells), *lines[row + 1 :]]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: [], "the file is empty"),
        (lambda lines: lines[:2], "1 samples"),
        (lambda lines: [lines[0].replace("a0_vy", "vy"), *lines[1:]], "column 'a0_vy' is missing"),
        (lambda lines: spoil(lines, 7, 2, "high"), "row 7, column a0_vy is 'high', not a number"),
        (lambda lines: spoil(lines, 7, 2, ""), "row 7, column a0_vy is empty"),
        (lambda lines: spoil(lines, 7, 3, "nan"), "row 7, column a0_vz is nan"),
        (lambda lines: [*lines[:9], "1.0,2.0", *lines[10:]], "row 9, column a0_vy is empty"),
        (lambda lines: lines[:50] + lines[80:], "a gap"),
        (lambda lines: lines[:1] + lines[1::2], "runs at 500 Hz"),
        (lambda lines: [*lines[:9], *lines[8:]], "does not increase"),
    ],
)
def test_a_bad_csv_is_refused_in_one_line(
    device: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change, says: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("".join(line + "\n" for line in change((device / "slide.csv").read_text().splitlines())))
    assert softslide.main(["predict", "--model", str(device / "bundle"), str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert str(path) in err
    assert says in err


@pytest.mark.parametrize("name", ["none.csv", "slide.txt"])
def test_a_file_that_cannot_be_read_is_refused(
    device: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    (device / "slide.txt").write_text("x")
    assert softslide.main(["predict", "--model", str(device / "bundle"), str(device / name)]) == 2
    assert name in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_help_comes_without_opening_a_room(command: str) -> None:
    done = run(command, "--help")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert f"softslide {command}" in done.stdout


def test_every_option_of_every_command_is_explained() -> None:
    commands = next(a for a in softslide._parser()._actions if a.dest == "command")
    for name, parser in commands.choices.items():  # type: ignore[union-attr]
        for action in parser._actions:
            assert action.help, f"{name}: {action.dest}"
            if action.default not in (None, False, "==SUPPRESS==") and action.option_strings:
                shown = parser._get_formatter()._expand_help(action)
                assert "default" in shown, f"{name} {action.option_strings}: {shown}"


def test_ctrl_c_is_one_line_and_130(tmp_path: Path) -> None:
    command = [sys.executable, str(HERE / "softslide.py"), "synthesize", "--slides", "500"]
    # What is started in the background is deaf to Ctrl-C, and hands that on.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(
        [*command, "--out", str(tmp_path / "out")], stderr=subprocess.PIPE, preexec_fn=heard
    ) as running:
        while not list(tmp_path.iterdir()):
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        _, error = running.communicate(timeout=60)
    assert running.returncode == 130
    assert error.decode().splitlines()[-1] == "softslide synthesize: interrupted"
    assert b"Traceback" not in error
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [[], ["dance"], ["evaluate"], ["predict", "--model", "b"]])
def test_bad_usage_is_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        softslide.main(arguments)
    assert stop.value.code == 2
    assert capsys.readouterr().out == ""

"""The command as a user meets it: help, exit statuses, and what runs with the base install alone."""

import ast
import importlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
import zipfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import pytest
from a_device import write_device
from front_door import refused
from linked import ROOMS
from sample_folder import sample_folder

import softslide
from softslide.command_line import parser
from softslide.pipeline.recordings.folder import SAMPLE
from softslide.pipeline.sensor import read_sensor

HERE = Path(__file__).parents[1]
# What a device does not have: everything but the base install, numpy and onnxruntime.
HEAVY = (
    *("torch", "sklearn", "mlflow", "scipy", "pandas", "numba", "pandera", "pyarrow", "onnx", "skl2onnx"),
    *("joblib", "dask", "matplotlib", "jinja2", "tqdm", "tomli_w", "h5py", "optuna"),
    *("fastapi", "uvicorn", "websockets", "serial"),
)
SUBPARSERS = next(a for a in parser()._actions if a.dest == "command").choices
COMMANDS = sorted(SUBPARSERS)  # type: ignore[arg-type]


def test_packages_are_those_of_this_tree() -> None:
    packages = tomllib.loads((HERE / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    inits = [path.relative_to(HERE).parent for room in ROOMS for path in (HERE / room).rglob("__init__.py")]
    assert set(packages) == {
        "softslide",
        "softslide.commands",
        *(".".join(("softslide", *i.parts)) for i in inits),
    }
    for name in packages:
        assert Path(importlib.import_module(name).__file__ or "").is_relative_to(HERE), name


def test_a_wheel_is_one_name_next_to_anybody_s_folders(tmp_path: Path) -> None:
    """A lab's own `features` and `models` are neither replaced nor imported; all data comes along."""
    tree = tmp_path / "tree"
    for name in ("softslide", *ROOMS):
        shutil.copytree(HERE / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copyfile(HERE / name, tree / name)
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", str(tree)]
    subprocess.run([*pip, "--wheel-dir", str(tmp_path)], check=True, capture_output=True, timeout=300)
    (wheel,) = tmp_path.glob("softslide-*.whl")
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        archive.extractall(site)
    assert {name.partition("/")[0].partition("-")[0] for name in names} == {"softslide"}
    files = [path.relative_to(tree) for room in ROOMS for path in (tree / room).rglob("*") if path.is_file()]
    assert {f"softslide/{file.as_posix()}" for file in files if file.name != "LOG.md"} <= set(names)
    for name in ("features", "models"):
        (tmp_path / "lab" / name).mkdir(parents=True)
        (tmp_path / "lab" / name / "__init__.py").write_text("raise SystemExit('the lab\\'s own')")
    command = [sys.executable, "-m", "softslide", "import", "--sensor-template"]
    outside = {"cwd": tmp_path / "lab", "env": os.environ | {"PYTHONPATH": str(site)}}
    done = subprocess.run(command, **outside, capture_output=True, text=True, timeout=120)
    assert 'name = "my-sensor"' in done.stdout, done.stderr


def run(*arguments: object, absent: Sequence[str] = HEAVY) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own where importing these fails, as on a device."""
    return python("sys.exit(softslide.main(sys.argv[1:]))", *arguments, absent=absent)


def python(
    code: str, *arguments: object, absent: Sequence[str] = HEAVY, given: str = ""
) -> subprocess.CompletedProcess[str]:
    script = f"""
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ModuleNotFoundError(name + " is not on this device", name=name)

sys.meta_path.insert(0, Absent())
sys.path.insert(0, {str(HERE)!r})
import softslide
{code}
"""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(command, input=given, capture_output=True, text=True, timeout=300)


def test_the_runtime_imports_numpy_and_onnxruntime_alone() -> None:
    modules = [
        ".".join(("softslide", *path.relative_to(HERE).with_suffix("").parts))
        for room in ("features", "serve")
        for path in sorted((HERE / room).rglob("*.py"))
    ]
    assert "softslide.serve.localizer" in modules
    code = f"import importlib\nfor name in {modules!r}: importlib.import_module(name)\n"
    done = python(f"{code}sys.exit(', '.join(set({HEAVY!r}) & set(sys.modules)) or 0)", absent=())
    assert done.stderr.strip() == ""
    assert done.returncode == 0


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_device(tmp_path_factory.mktemp("device"))


def test_a_device_predicts_from_csv(device: Path) -> None:
    done = run("predict", "--model", device / "bundle", device / "slide.csv", device / "slide.csv")
    assert done.returncode == 0, done.stderr
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert first == second
    assert first["recording"] == "slide"
    assert first["direction_deg"] == pytest.approx(30.0, abs=1e-4)
    assert first["depth_mm"] is None
    assert first["valid"] is True


def test_parquet_and_csv_predict_the_same(device: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = (device / "slide.csv", device / "slide.parquet")
    assert softslide.main(["predict", "--model", str(device / "bundle"), *map(str, files)]) == 0
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
        (
            lambda lines: [
                lines[0],
                *(f"{1.004 * float(t)!r},{v}" for t, v in (x.split(",", 1) for x in lines[1:])),
            ],
            "runs at 996.0",
        ),
    ],
)
def test_a_bad_csv_is_refused_in_one_line(
    device: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change, says: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("".join(line + "\n" for line in change((device / "slide.csv").read_text().splitlines())))
    said = refused(capsys, "predict", "--model", device / "bundle", path)
    assert str(path) in said
    assert says in said


def test_a_file_that_cannot_be_read_is_refused(device: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (device / "slide.txt").write_text("x")
    for name in ("none.csv", "slide.txt"):
        assert name in refused(capsys, "predict", "--model", device / "bundle", device / name)


def test_help_comes_without_opening_a_room() -> None:
    code = """
for command in sys.argv[1:]:
    try:
        softslide.main([command, "--help"])
    except SystemExit as done:
        assert not done.code
"""
    done = python(code, *COMMANDS)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert all(f"softslide {command}" in done.stdout for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_explains_every_option_and_is_read_as_it_is_written(command: str) -> None:
    parser = SUBPARSERS[command]  # type: ignore[index]
    for action in parser._actions:
        assert action.help, action.dest
        if action.default not in (None, False, True, "==SUPPRESS==") and action.option_strings:
            assert "default" in parser._get_formatter()._expand_help(action), action.option_strings
    shown = parser.format_help()
    assert "%%" not in shown
    assert f"    softslide {command} " in shown, "no example"
    assert max(map(len, (parser.description or "").splitlines())) <= 88


def test_the_version_is_printed() -> None:
    done = run("--version")
    assert (done.returncode, done.stdout) == (0, f"softslide {softslide.__version__}\n")


SENSOR = ("--sensor", SAMPLE / "sensor.toml")
RECORDINGS = ("--recordings", SAMPLE)
OUT = ("--out", "out")
# A call of every command, complete but for the extras that it needs.
CALLS: dict[str, tuple[object, ...]] = {
    "check": (SAMPLE,),
    "import": (SAMPLE / "slides", "--map", SAMPLE / "sensor.toml", *OUT),
    "simulate": (*SENSOR, *OUT),
    "synthesize": ("--slides", 1, *OUT),
    "export-recordings": (*RECORDINGS, *OUT),
    "demo": OUT,
    "train": (*RECORDINGS, *OUT),
    "evaluate": ("--model", SAMPLE, *RECORDINGS, *OUT),
    "export": ("--model", SAMPLE, "--to", "ort", *OUT),
    "recalibrate": ("--model", SAMPLE, *RECORDINGS, *OUT),
    "article": (*RECORDINGS, *OUT),
    "compare": (*RECORDINGS, *OUT),
    "design": (*SENSOR, *OUT),
    "plan": (*SENSOR, *OUT),
    "record": ("--source", "udp://:9", "--plan", SAMPLE / "manifest.csv", *OUT),
    "predict": ("--model", "BUNDLE", "slide.parquet"),
    "serve": ("--model", "BUNDLE", "--source", "-", "--page", "0"),
}
EXTRAS = dict.fromkeys(("check", "import", "synthesize", "export-recordings", "predict", "record"), "io") | {
    "serve": "live"
}


# Calls one after the other, as JSON on standard input -> their exit statuses and what they say on standard error.
ONE_BY_ONE = """
import contextlib, io, json
for words in json.load(sys.stdin):
    with contextlib.redirect_stderr(io.StringIO()) as said:
        status = softslide.main(words)
    print(json.dumps([status, said.getvalue()]))
"""


def on_a_device(calls: Sequence[Sequence[object]]) -> list[list]:
    """[exit status, what is said on standard error] of each call, of all in a process where imports fail."""
    done = python(ONE_BY_ONE, given=json.dumps([list(map(str, words)) for words in calls]))
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_a_missing_extra_is_said_in_one_line(device: Path, tmp_path: Path) -> None:
    places = {"BUNDLE": device / "bundle", "slide.parquet": device / "slide.parquet", "out": tmp_path / "out"}
    calls = [[command, *(places.get(word, word) for word in CALLS[command])] for command in COMMANDS]
    for command, (status, said) in zip(COMMANDS, on_a_device(calls), strict=True):
        extra = EXTRAS.get(command, "train")
        last = f"softslide {command} needs softslide[{extra}]: pip install 'softslide[{extra}]'"
        assert (status, said.splitlines()[-1]) == (2, last)
        assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


def test_a_registered_bundle_needs_the_extra_that_has_the_registry(device: Path) -> None:
    done = run("predict", "--model", "models:/softslide@champion", device / "slide.csv")
    assert done.returncode == 2
    assert done.stderr == "softslide predict needs softslide[train]: pip install 'softslide[train]'\n"


def test_a_module_of_our_own_that_is_missing_is_not_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "softslide.pipeline.recordings.folder", None)
    monkeypatch.delitem(sys.modules, "softslide.experiments.check", raising=False)
    with pytest.raises(ModuleNotFoundError, match=r"pipeline\.recordings"):
        softslide.main(["check", str(SAMPLE)])


@pytest.mark.parametrize("place", ["/proc/none", "a-file/out"])
@pytest.mark.parametrize("command", [name for name, words in CALLS.items() if OUT[0] in words])
def test_a_place_that_cannot_be_written_is_said_before_the_work(
    command: str,
    place: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a-file").write_text("")
    assert softslide.main([command, *(place if word == "out" else str(word) for word in CALLS[command])]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"softslide {command}: {place}: cannot be written")


FROM_DEVICE = ("BUNDLE", "slide.parquet")
GIVEN = [(c, w) for c, words in CALLS.items() for w in words if isinstance(w, Path) or w in FROM_DEVICE]


def test_a_mistyped_path_is_refused_before_anything_heavy_is_imported() -> None:
    calls = []
    for command, word in GIVEN:
        words = ["nowhere" if w == word else SAMPLE if w in FROM_DEVICE else w for w in CALLS[command]]
        calls.append([command, *words])
    for (command, _), answer in zip(GIVEN, on_a_device(calls), strict=True):
        line = f"softslide {command}: nowhere: no such file or folder; name one that exists\n"
        assert answer == [2, line]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("synthesize --slides 0", "--slides 0: at least one is needed, or a path"),
        ("synthesize --paths -1", "--paths -1: it must not be negative"),
        ("synthesize --slides 1 --seed -1", "--seed -1: it must not be negative"),
        ("simulate --jobs 0", "--jobs 0: at least one is needed"),
        ("simulate --workers 0", "--jobs 0: at least one is needed"),
    ],
)
def test_a_bad_value_is_named_by_its_option(
    words: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert softslide.main([*words.split(), "--out", str(tmp_path / "out")]) == 2
    *_, last = capsys.readouterr().err.splitlines()
    assert last == f"softslide {words.split()[0]}: {says}"


def test_no_library_knows_an_option() -> None:
    """A library's errors name its parameters; which option a value came from is the command line's business."""
    options = {o for parser in SUBPARSERS.values() for a in parser._actions for o in a.option_strings}  # type: ignore[union-attr]
    for room in ("features", "pipeline", "models", "serve", "experiments"):
        for path in sorted((HERE / room).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Raise) and node.exc is not None:
                    text = ast.unparse(node.exc)
                    named = [o for o in options if len(o) > 2 and re.search(rf"(?<![\w-]){o}(?![\w-])", text)]
                    assert not named, f"{path}:{node.lineno}: {named}"


def test_ctrl_c_is_one_line_and_130(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "softslide", "synthesize", "--slides", "500"]
    command += ["--out", str(tmp_path / "out")]
    # What is started in the background is deaf to Ctrl-C, and hands that on.
    heard = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(command, stderr=subprocess.PIPE, preexec_fn=heard) as running:
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


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_full_disk_is_one_line() -> None:
    command = [sys.executable, "-m", "softslide", "import", "--sensor-template"]
    with open("/dev/full", "wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False, timeout=120)
    assert done.returncode == 1
    (line,) = done.stderr.decode().splitlines()
    assert line.startswith("softslide import: the output: No space left on device; ")


def test_the_template_of_a_sensor_is_a_sensor(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert softslide.main(["import", "--sensor-template"]) == 0
    (tmp_path / "sensor.toml").write_text(capsys.readouterr().out)
    assert read_sensor(tmp_path / "sensor.toml").name == "my-sensor"


def test_check_needs_the_io_extra_alone(tmp_path: Path) -> None:
    others = ("torch", "sklearn", "numba", "mlflow", "matplotlib", "joblib", "onnx")
    done = run("check", sample_folder(tmp_path / "few", "split == 'test-fast'"), absent=others)
    assert done.returncode == 0, done.stderr

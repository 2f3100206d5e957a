"""A fresh environment for the base install and for each extra: every command works or names the extra it lacks.

On this Python, and for what a robot and a lab's computer need on the others that are here.
"""

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from a_device import write_device
from lab_files import FORMATS, write_lab
from test_front_door import CALLS

from softslide.pipeline.recordings.folder import SAMPLE

pytestmark = pytest.mark.long
HERE = Path(__file__).parents[1]
EXTRAS = tomllib.loads((HERE / "pyproject.toml").read_text())["project"]["optional-dependencies"]
OTHERS = tuple(name for name in ("python3.12", "python3.13", "python3.14") if shutil.which(name))
ON = [(sys.executable, extra) for extra in ("", "io", "live", "train")]
ON += [(python, extra) for python in OTHERS for extra in ("", "io", "live")]
# A command that is still at work after this time lacks nothing: what it needs it imports first.
AT_WORK_S = 20
PATIENCE_S = 300


@dataclass(frozen=True)
class Environment:
    """extras: the one installed, and those that it brings. softslide: the command there. lab: files to work on."""

    extras: set[str]
    softslide: Path
    lab: Path

    def run(self, *words: object, patience_s: float = PATIENCE_S) -> subprocess.CompletedProcess[str]:
        command = [str(self.softslide), *map(str, words)]
        return subprocess.run(command, cwd=self.lab, capture_output=True, text=True, timeout=patience_s)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tracked files alone, as they are now: building a package writes next to them."""
    copy = tmp_path_factory.mktemp("tree") / "softslide"
    names = subprocess.run(["git", "ls-files", "-z"], cwd=HERE, capture_output=True, check=True).stdout
    for name in filter(None, names.decode().split("\0")):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(HERE / name, copy / name)
    return copy


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle, a recording as CSV and as Parquet, and a lab's own files with their map."""
    root = write_device(tmp_path_factory.mktemp("lab"))
    write_lab(root / "theirs", FORMATS["csv"], ("one", "two"))
    return root


@pytest.fixture(scope="module", params=ON, ids=lambda on: f"{Path(on[0]).name}-{on[1] or 'base'}")
def fresh(
    request: pytest.FixtureRequest, tree: Path, lab: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Environment]:
    python, extra = request.param
    folder = tmp_path_factory.mktemp(f"fresh-{extra or 'base'}")
    made = subprocess.run(
        [python, "-m", "venv", folder], capture_output=True, timeout=PATIENCE_S, check=False
    )
    if made.returncode:
        pytest.skip(f"{python} does not make an environment")
    what = f"{tree}[{extra}]" if extra else str(tree)
    pip = [folder / "bin" / "python", "-m", "pip", "install", "--quiet", "-c", tree / "constraints.txt", what]
    subprocess.run(pip, check=True, timeout=1800)
    brought = set(re.findall(r"softslide\[(\w+)\]", " ".join(EXTRAS.get(extra, ()))))
    yield Environment({extra, *brought}, folder / "bin" / "softslide", lab)
    shutil.rmtree(folder)


@pytest.mark.parametrize("command", sorted(CALLS))
def test_it_works_or_names_its_extra(fresh: Environment, tmp_path: Path, command: str) -> None:
    lab = fresh.lab
    places = {"BUNDLE": lab / "bundle", "slide.parquet": lab / "slide.parquet", "out": tmp_path / "out"}
    try:
        done = fresh.run(command, *(places.get(w, w) for w in CALLS[command]), patience_s=AT_WORK_S)
    except subprocess.TimeoutExpired:
        return
    assert "Traceback" not in done.stderr
    assert "No module named" not in done.stderr
    named = set(re.findall(r"needs softslide\[(\w+)\]", done.stderr))
    assert not named & fresh.extras
    assert not named or done.returncode == 2


def test_what_an_extra_is_for_works(fresh: Environment, tmp_path: Path) -> None:
    bundle, slide, out = fresh.lab / "bundle", fresh.lab / "slide.csv", tmp_path
    serve = ["serve", "--model", bundle, "--source", slide, "--fast"]
    calls: list[list[object]] = [["predict", "--model", bundle, slide], serve]
    if "live" in fresh.extras:
        calls.append([*serve, "--page", "0"])
    if "io" in fresh.extras:
        theirs = fresh.lab / "theirs"
        calls += [
            ["predict", "--model", bundle, fresh.lab / "slide.parquet"],
            ["synthesize", "--slides", 2, "--seed", 1, "--out", out / "made"],
            ["check", out / "made"],
            ["import", theirs / "lab", "--map", theirs / "map.toml", "--out", out / "imported"],
        ]
    if "train" in fresh.extras:
        calls += [
            ["train", "--recordings", SAMPLE, "--model", "interpolation", "--out", out / "trained"],
            ["export", "--model", out / "trained", "--to", "c", "--out", out / "c"],
            ["evaluate", "--model", out / "trained", "--recordings", SAMPLE, "--out", out / "results"],
        ]
    for call in calls:
        done = fresh.run(*call)
        # 1: a bound that is not met.
        assert done.returncode == 0 or (call[0] == "evaluate" and done.returncode == 1), (call, done.stderr)
        assert "Traceback" not in done.stderr

"""A disk that fills up while a command writes: one line, no half-written output, and the next call ends well."""

import os
import shutil
import subprocess
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from forked import Commands, commands
from lab_files import FORMATS, write_lab
from sender import PLAN, TIMES, free_port, sending
from small_bundle import write_small_bundle
from streams import a_sensor
from trial_folder import SENSOR, a_folder

from pipeline.atlas.atlas import DEFAULT_SENSOR
from pipeline.recordings.folder import SAMPLE, read_folder
from pipeline.sensor import write_sensor

# A mount that only the commands see, and no other rights than the tests' own.
MOUNT = ("unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o size=256m small "$0" && exec "$@"')
PAGE = 4096  # bytes that a tmpfs gives at a time
# More than a bundle of `interpolation`, 60 kB, and less than what is kept of its run, 240 kB, beside it.
NO_SPACE = "No space left on device; free some space, or name a place that can be written"


@dataclass(frozen=True)
class Disk:
    """A small disk. place: as commands name it; seen: as the tests reach it."""

    softslide: Commands
    place: Path
    seen: Path

    def free(self) -> int:
        """Bytes."""
        told = os.statvfs(self.seen)
        return told.f_bavail * told.f_frsize

    def leave(self, size: int) -> None:
        """Fills it up but for so many bytes."""
        with (self.seen / "ballast").open("wb") as file:
            os.posix_fallocate(file.fileno(), 0, self.free() - size)

    def names(self) -> set[str]:
        """What is on it, the ballast aside."""
        return {path.name for path in self.seen.iterdir()} - {"ballast"}

    def empty(self) -> None:
        for path in self.seen.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()


@pytest.fixture(scope="module")
def mounted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Disk]:
    place = tmp_path_factory.mktemp("small") / "disk"
    place.mkdir()
    if not shutil.which("unshare") or subprocess.run([*MOUNT, str(place), "true"], check=False).returncode:
        pytest.skip("no small disk can be mounted here")
    with commands([*MOUNT, str(place)]) as softslide:
        yield Disk(softslide, place, softslide.root / place.relative_to("/"))


@pytest.fixture
def disk(mounted: Disk) -> Disk:
    mounted.empty()
    return mounted


def words(*given: object) -> list[str]:
    return [str(word) for word in given]


def ran(disk: Disk, command: list[str], folder: Path) -> list[str]:
    """The lines that it said."""
    disk.softslide.start(command, folder)
    disk.softslide.finish()
    return folder.with_name(f"{folder.name}.log").read_text().splitlines()


def check(
    disk: Disk,
    command: list[str],
    folder: Path,
    *,
    kept: Collection[str] = (),
    given: Mapping[str, str] | None = None,
    tenths: Collection[int] = (3, 6, 9),
) -> None:
    """Runs it with all the space it needs, with none, with so many tenths of it, and again with all.

    kept: what a call that broke off may leave for the next one. given: files that lie on the disk, name -> text.
    """

    def cleared() -> None:
        disk.empty()
        for name, text in (given or {}).items():
            (disk.seen / name).write_text(text)

    cleared()
    before = disk.free()
    ran(disk, command, folder)
    assert disk.softslide.status == 0
    whole, used = disk.names(), before - disk.free()
    assert used
    cleared()
    for part in (0, *tenths):
        disk.leave(max(used * part // 10, PAGE) if part else 0)
        *_, last = said = ran(disk, command, folder)
        assert disk.softslide.status == 1, said
        assert last.startswith(f"softslide {command[0]}: "), said
        assert last.endswith(NO_SPACE), said
        assert not [line for line in said if "Traceback" in line], said
        assert disk.names() <= {*kept, *(given or {})}, said
    (disk.seen / "ballast").unlink()
    ran(disk, command, folder)
    assert disk.softslide.status == 0
    assert disk.names() == whole


def test_import(disk: Disk, tmp_path: Path) -> None:
    write_lab(tmp_path / "lab", FORMATS["csv"], ("one", "two", "three"))
    command = words("import", tmp_path / "lab" / "lab", "--map", tmp_path / "lab" / "map.toml")
    check(disk, [*command, "--out", str(disk.place / "out")], tmp_path / "work", kept={".out.partial"})


def test_synthesize(disk: Disk, tmp_path: Path) -> None:
    command = words("synthesize", "--slides", 3, "--seed", 4, "--out", disk.place / "out")
    check(disk, command, tmp_path / "work")


@pytest.mark.long
def test_evaluate(disk: Disk, tmp_path: Path) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)
    lab = a_folder(tmp_path / "lab", **{f"r{n}": {} for n in range(3)}).root
    command = words("evaluate", "--model", bundle, "--recordings", lab, "--allow-untested")
    out = ["--out", str(disk.place / "out")]
    check(disk, [*command, *out], tmp_path / "work", kept={".out.work"}, tenths=(5,))


@pytest.mark.long
def test_train(disk: Disk, tmp_path: Path) -> None:
    command = words("train", "--recordings", SAMPLE, "--model", "interpolation", "--out", disk.place / "out")
    check(disk, command, tmp_path / "work", tenths=(6,))


def test_a_full_store_costs_no_training(disk: Disk, tmp_path: Path) -> None:
    """It costs the run, in one line."""
    command = words("train", "--recordings", SAMPLE, "--model", "interpolation", "--out")
    (tmp_path / "work.store").symlink_to(disk.place)
    disk.leave(0)
    said = ran(disk, [*command, str(tmp_path / "bundle")], tmp_path / "work")
    assert disk.softslide.status == 0, said
    (line,) = [line for line in said if "run not logged" in line]
    assert "No space left on device" in line
    assert (tmp_path / "bundle" / "model.onnx").exists()


@pytest.mark.parametrize("to", ["ort", "c"])
def test_export(disk: Disk, tmp_path: Path, to: str) -> None:
    bundle = write_small_bundle(tmp_path / "bundle", SENSOR, offset_mm_per_v=50.0)
    check(disk, words("export", "--model", bundle, "--to", to, "--out", disk.place / "out"), tmp_path / to)


@pytest.mark.long
def test_record(disk: Disk, tmp_path: Path) -> None:
    """A recording that was kept before stays."""
    write_sensor(tmp_path / "sensor.toml", a_sensor())
    plan = tmp_path / "plan.csv"
    plan.write_text(f"{PLAN}one,calibration,0,40,-5,-29,-5,8,0.5\ntwo,test,180,40,-5,29,5,8,0.5\n")
    port = free_port()
    command = words(
        "record", "--source", f"udp://:{port}", "--plan", plan, "--sensor", tmp_path / "sensor.toml"
    )
    command += words("--out", disk.place / "out", "--yes", *TIMES)
    with sending(port):
        check(disk, command, tmp_path / "work", kept={"out"}, tenths=(6,))
    assert len(read_folder(disk.seen / "out")) == 2


@pytest.mark.long
def test_simulate(disk: Disk, tmp_path: Path) -> None:
    text = DEFAULT_SENSOR.read_text().replace("[5.0, 7.0, 9.6]", "[6.0]")
    sensor = tmp_path / "sensor.toml"
    sensor.write_text(text.replace("size_mm = 2.5", "size_mm = 5.0"))
    command = words("simulate", "--sensor", sensor, "--coarse", "--depth", 0.5, "--out", disk.place / "a.npz")
    check(disk, command, tmp_path / "work", kept={".a.npz.lines"}, tenths=(3,))

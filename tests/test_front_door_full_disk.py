"""A disk that fills up while a command writes: one line, no half-written output, and the next call ends well."""

import os
import shutil
import subprocess
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from bump_slides import bump_folder, bump_sensor, lines
from forked import Commands, commands
from long_commands import SYNTHESIZE, TRAIN, a_simulation, an_evaluation, an_import
from sender import PLAN, TIMES, free_port, sending
from streams import a_sensor

from softslide.pipeline.recordings.folder import read_folder
from softslide.pipeline.sensor import write_sensor

# A mount that only the commands see, and no other rights than the tests' own.
MOUNT = ("unshare", "-rm", "sh", "-c", 'mount -t tmpfs -o size=256m small "$0" && exec "$@"')
PAGE = 4096  # bytes that a tmpfs gives at a time
NO_SPACE = "No space left on device; free some space, or name a place that can be written"


@dataclass(frozen=True)
class Disk:
    """A small disk. place: as commands name it; seen: as the tests reach it."""

    softslide: Commands
    place: Path
    seen: Path

    def free(self) -> int:
        """Bytes."""
        status = os.statvfs(self.seen)
        return status.f_bavail * status.f_frsize

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
    out: str = "out",
    kept: Collection[str] = (),
    tenths: Collection[int] = (3, 6, 9),
) -> None:
    """Runs it with all the space it needs, with none, with so many tenths of it, and again with all.

    out: its output on the disk. kept: what a call that broke off may leave for the next one.
    """
    command = [*command, "--out", str(disk.place / out)]
    disk.empty()
    before = disk.free()
    ran(disk, command, folder)
    assert disk.softslide.status == 0
    whole, used = disk.names(), before - disk.free()
    assert used
    disk.empty()
    for part in (0, *tenths):
        disk.leave(max(used * part // 10, PAGE) if part else 0)
        *_, last = said = ran(disk, command, folder)
        assert disk.softslide.status == 1, said
        assert last.startswith(f"softslide {command[0]}: "), said
        assert last.endswith(NO_SPACE), said
        assert not [line for line in said if "Traceback" in line], said
        assert disk.names() <= {*kept}, said
    (disk.seen / "ballast").unlink()
    ran(disk, command, folder)
    assert disk.softslide.status == 0
    assert disk.names() == whole


def test_import(disk: Disk, tmp_path: Path) -> None:
    command = an_import(tmp_path, ("one", "two", "three"))
    # Of nine tenths two recordings stay, so that in four more it is the folder that finds no space.
    check(disk, command, tmp_path / "work", kept={".out.partial"}, tenths=(9, 4))


def test_synthesize(disk: Disk, tmp_path: Path) -> None:
    check(disk, SYNTHESIZE, tmp_path / "work")


@pytest.mark.long
def test_evaluate(disk: Disk, tmp_path: Path) -> None:
    check(disk, an_evaluation(tmp_path, 3), tmp_path / "work", kept={".out.work"}, tenths=(5,))


@pytest.mark.long
def test_train(disk: Disk, tmp_path: Path) -> None:
    check(disk, TRAIN, tmp_path / "work", tenths=(6,))


def test_a_full_store_costs_no_training(disk: Disk, tmp_path: Path) -> None:
    """It costs the run, in one line."""
    (tmp_path / "work.store").symlink_to(disk.place)
    disk.leave(0)
    slides = lines((0.0, 90.0, 180.0, 270.0), (-9.0, -6.0, -3.0, 3.0, 6.0, 9.0), (12.0, 20.0))
    lab = bump_folder(tmp_path / "lab", bump_sensor(1), {"calibration": slides}).root
    command = ["train", "--recordings", str(lab), "--model", "interpolation"]
    said = ran(disk, [*command, "--out", str(tmp_path / "bundle")], tmp_path / "work")
    assert disk.softslide.status == 0, said
    (line,) = [line for line in said if "run not logged" in line]
    assert "no space left on device" in line.lower()
    assert (tmp_path / "bundle" / "model.onnx").exists()


def test_export(disk: Disk, tmp_path: Path, bundle: Path) -> None:
    check(disk, ["export", "--model", str(bundle), "--to", "ort"], tmp_path / "ort")


@pytest.mark.long
def test_record(disk: Disk, tmp_path: Path) -> None:
    """A recording that was kept before stays."""
    sensor, plan, port = tmp_path / "sensor.toml", tmp_path / "plan.csv", free_port()
    write_sensor(sensor, a_sensor())
    plan.write_text(f"{PLAN}one,calibration,0,40,-5,-29,-5,8,0.5\ntwo,test,180,40,-5,29,5,8,0.5\n")
    command = ["record", "--source", f"udp://:{port}", "--plan", str(plan), "--sensor", str(sensor)]
    with sending(port):
        check(disk, [*command, "--yes", *TIMES], tmp_path / "work", kept={"out"}, tenths=(6,))
    assert len(read_folder(disk.seen / "out")) == 2


@pytest.mark.long
def test_simulate(disk: Disk, tmp_path: Path) -> None:
    command, kept = a_simulation(tmp_path), {".a.npz.lines"}
    check(disk, command, tmp_path / "work", out="a.npz", kept=kept, tenths=(3,))

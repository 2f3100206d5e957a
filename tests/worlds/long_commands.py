"""Commands that write for a while, for tests that kill them, leave them no space, or call them twice at once."""

import hashlib
from pathlib import Path

from lab_files import FORMATS, write_lab
from small_bundle import write_small_bundle
from trial_folder import SENSOR, a_folder

from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR
from softslide.pipeline.recordings.folder import SAMPLE

SYNTHESIZE = ["synthesize", "--slides", "3", "--seed", "4"]
TRAIN = ["train", "--recordings", str(SAMPLE), "--model", "interpolation"]


def an_import(root: Path, names: tuple[str, ...]) -> list[str]:
    write_lab(root / "lab", FORMATS["csv"], names)
    return ["import", str(root / "lab" / "lab"), "--map", str(root / "lab" / "map.toml")]


def an_evaluation(root: Path, recordings: int) -> list[str]:
    bundle = write_small_bundle(root / "bundle", SENSOR, offset_mm_per_v=50.0)
    lab = a_folder(root / "lab", **{f"r{n}": {} for n in range(recordings)}).root
    return ["evaluate", "--model", str(bundle), "--recordings", str(lab), "--allow-untested"]


def a_simulation(root: Path) -> list[str]:
    text = DEFAULT_SENSOR.read_text().replace("[5.0, 7.0, 9.6]", "[6.0]")
    (root / "sensor.toml").write_text(text.replace("size_mm = 2.5", "size_mm = 5.0"))
    return ["simulate", "--sensor", str(root / "sensor.toml"), "--coarse", "--depth", "0.5"]


def contents(place: Path) -> dict[str, str]:
    """A hash of each file in and below a folder, or of the file itself; empty where there is nothing."""
    files = [place] if place.is_file() else sorted(path for path in place.rglob("*") if path.is_file())
    return {str(path.relative_to(place)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

"""The atlas of a sensor, named, shipped, cached, or solved now."""

import os
import sys
from pathlib import Path

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import Atlas, check_atlas, read_atlas, write_atlas
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.sensor import Sensor, check_design, design_hash


def atlas_of(sensor: Sensor, named: str | Path | None = None, workers: int = 2) -> Atlas:
    """The sensor's atlas; says on standard error where it is from.

    A design that is not the shipped one is solved coarsely (minutes on two cores) and cached in the user's cache
    folder, `SOFTSLIDE_CACHE` if that is set.

    Raises:
        InputError: the file named is not an atlas or one of another design, or the design cannot be solved.
    """
    if not sensor.measures_gravity:
        check_design(sensor, sensor.name)
    if (atlas := atlas_at_hand(sensor, named)) is not None:
        return atlas
    # The solver needs numba, which the io extra does not bring.
    from softslide.pipeline.atlas.solve import COARSE, coarsened, solve_atlas

    cached = _cached(sensor)
    print(
        f"atlas: none of {sensor.name} yet; solving a coarse one (minutes), to be cached in {cached}",
        file=sys.stderr,
    )
    atlas = solve_atlas(
        coarsened(sensor),
        COARSE,
        workers=workers,
        work=cached.with_suffix(".work"),
        progress=lambda lines, count: progress_bar("solving", "line", lines, count),
        source=sensor.name,
    )
    write_atlas(atlas, cached)
    return atlas


def atlas_at_hand(sensor: Sensor, named: str | Path | None = None) -> Atlas | None:
    """The sensor's atlas that is named, ships or was solved earlier; None: there is none.

    Raises:
        InputError: the file named is not an atlas or one of another design.
    """
    if not sensor.measures_gravity:
        if named is None:
            return None
        check_design(sensor, sensor.name)
    if named is not None:
        atlas = read_atlas(Path(named))
        check_atlas(atlas, sensor, str(named))
        return atlas
    if (shipped := read_atlas()).meta["design_hash"] == design_hash(sensor):
        print("atlas: the one that ships, of the article's sensor", file=sys.stderr)
        return shipped
    cached = _cached(sensor)
    if not cached.exists():
        return None
    try:
        atlas = read_atlas(cached)
    except InputError:
        cached.unlink()
        return None
    print(f"atlas: {cached}, solved earlier", file=sys.stderr)
    return atlas


def _cached(sensor: Sensor) -> Path:
    return cache_folder() / f"coarse-{design_hash(sensor)}.npz"


def cache_folder() -> Path:
    """The user's cache folder: of atlases and calibrated maps."""
    if named := os.environ.get("SOFTSLIDE_CACHE"):
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "softslide"

"""Solves a sensor design's atlas: lines of the indenter in parallel, resumable, then gathered on a grid."""

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from softslide.features.errors import InputError
from softslide.pipeline.atlas.atlas import DEFAULT_SENSOR, Atlas, write_atlas
from softslide.pipeline.atlas.line_store import LineStore, Task
from softslide.pipeline.progress import progress_bar
from softslide.pipeline.ranges import check_ranges
from softslide.pipeline.sensor import Sensor, check_design, design_hash, design_of, read_sensor
from softslide.pipeline.skin.lines import (
    PER_BOARD,
    Line,
    all_lines,
    join_families,
    lines_to_solve,
    reach_mm,
)
from softslide.pipeline.skin.solved_line import gravity, skin_of, solve_line
from softslide.pipeline.skin.solver import TOLERANCE_N, NoEquilibrium, Statistics
from softslide.pipeline.skin.system import State
from softslide.pipeline.workers import results


@dataclass(frozen=True)
class Grid:
    """How finely an atlas is solved. Lengths in mm.

    The step along a line is one that continuation converges with; lines lie further apart, as the response is smooth.
    """

    depth_mm: tuple[float, ...] = (0.2, 0.6, 1.2)
    line_mm: float = 2.5
    steps_per_line: int = 2

    def __post_init__(self) -> None:
        if not self.depth_mm or min(self.depth_mm) < 0 or list(self.depth_mm) != sorted(set(self.depth_mm)):
            raise ValueError(f"depth_mm is {list(self.depth_mm)}; it must not be negative and must rise")
        check_ranges(self, line_mm=(0.5, 6.0))
        if self.line_mm / self.steps_per_line > 1.26:
            raise ValueError(f"steps of {self.line_mm / self.steps_per_line:g} mm are too long; at most 1.25")

    def axes(self, sensor: Sensor) -> tuple[np.ndarray, ...]:
        """Places along x and along y, and the lines' y and x, symmetric, from clear of the skin to clear of it."""
        cells = [math.ceil((reach + 0.5) / self.line_mm) for reach in reach_mm(sensor)]
        steps = [self.steps_per_line * each for each in cells]
        x, y = (self.line_mm / self.steps_per_line * np.arange(-each, each + 1) for each in steps)
        line_x, line_y = (self.line_mm * np.arange(-each, each + 1) for each in cells)
        return x, y, line_y, line_x


COARSE = Grid(depth_mm=(0.3, 1.0), line_mm=5.0, steps_per_line=4)
Progress = Callable[[Iterable[Any], int], Iterable[Any]]
# Solved lines: values (n, channels) and what they cost.
Done = dict[Task, tuple[np.ndarray, dict[str, float]]]
# `direction_deg` of a line's axis and sense.
HEADING_DEG = {(0, 1): 0.0, (0, -1): 180.0, (1, 1): 90.0, (1, -1): 270.0}


def coarsened(sensor: Sensor) -> Sensor:
    """The same design with larger elements, for `COARSE`: minutes on two cores."""
    return replace(sensor, mesh=replace(sensor.mesh, size_mm=max(sensor.mesh.size_mm, 3.4)))


def solve_atlas(
    sensor: Sensor,
    grid: Grid | None = None,
    *,
    workers: int = 1,
    backend: str = "loky",
    scheduler: str = "",
    work: Path | None = None,
    progress: Progress | None = None,
    source: str = "sensor",
) -> Atlas:
    """Solves every line that a design's atlas needs.

    Args:
        workers: processes; with backend "dask", the connected (or a local) cluster is used instead of "loky".
        scheduler: address of a Dask cluster that does the work instead.
        work: folder that keeps each finished line, so that an interrupted solve resumes; removed at the end.
        progress: wraps the stream of finished lines, given their number.

    Raises:
        InputError: a board out of place, or a pressure or height beyond the skin's limit.
    """
    grid = grid or Grid()
    check_design(sensor, source)
    levels = _levels(sensor, source)
    grids = grid.axes(sensor)
    wanted = lines_to_solve(grids, sensor)
    # The highest pressure takes longest: first, so that no worker is left with it at the end.
    tasks = [
        (level, depth, line)
        for level in reversed(range(len(levels)))
        for depth in range(len(grid.depth_mm))
        for line in wanted
    ]
    key = [design_of(sensor), asdict(sensor.mesh), asdict(grid), [round(p, 9) for p, _ in levels]]
    store = None if work is None else LineStore(work, key)
    done = {} if store is None else store.finished(tasks)
    calls = [
        ((level, depth, line), sensor, line, grids[line.axis], grid.depth_mm[depth], *levels[level])
        for level, depth, line in tasks
        if (level, depth, line) not in done
    ]
    stream = _parallel(calls, workers, backend, scheduler)
    for task, values, statistics in progress(stream, len(calls)) if progress else stream:
        done[task] = (values, statistics)
        if store is not None:
            store.keep(task, values, statistics)
    atlas = _gather(sensor, grid, levels, done, grids)
    if store is not None:
        store.remove()
    return atlas


def simulate(
    sensor: str | Path | None,
    out: str | Path,
    coarse: bool = False,
    depth_mm: Sequence[float] | None = None,
    jobs: int = 2,
    backend: str = "loky",
    scheduler: str = "",
) -> Atlas:
    """`softslide simulate`: reads a design, solves it, writes the atlas, says what did not converge.

    sensor: None: the article's. coarse: minutes in place of an hour. depth_mm: contact depths; None: the grid's own.

    Raises:
        InputError: see `solve_atlas`; an `out` that is a folder; a depth that is not positive.
    """
    path, out = sensor or DEFAULT_SENSOR, Path(out)
    design = read_sensor(path)
    if out.is_dir():
        raise InputError(f"{out}: a folder; name a file that ends in .npz")
    if jobs < 1:
        raise InputError(f"{jobs}: at least one is needed", "jobs")
    grid = COARSE if coarse else Grid()
    try:
        grid = replace(grid, depth_mm=tuple(depth_mm)) if depth_mm else grid
    except ValueError as error:
        raise InputError(f"{' '.join(f'{d:g}' for d in depth_mm or ())}: {error}", "depth_mm") from None
    atlas = solve_atlas(
        coarsened(design) if coarse else design,
        grid,
        workers=jobs,
        backend=backend,
        scheduler=scheduler,
        work=out.with_name(f".{out.name}.lines"),
        progress=lambda lines, count: progress_bar("solving", "line", lines, count),
        source=str(path),
    )
    write_atlas(atlas, out)
    cost = atlas.meta["statistics"]
    print(
        f"{out}: {cost['positions']} positions in {cost['seconds']:.0f} core-seconds, {len(atlas.failed)} failed"
        f", rest error {atlas.meta['rest_error_g']:.1e} g",
        file=sys.stderr,
    )
    for line in _left_out(atlas):
        print(line, file=sys.stderr)
    return atlas


def _left_out(atlas: Atlas) -> Iterator[str]:
    """For people, what was not solved: a line for each heading, depth and height of the skin, then what may help."""
    groups: dict[tuple[float, ...], list[list[float]]] = {}
    for x, y, *of in atlas.failed:
        groups.setdefault(tuple(of), []).append([x, y])
    for (heading, depth, height), places in groups.items():
        (left, low), (right, high) = np.min(places, axis=0), np.max(places, axis=0)
        yield (
            f"no equilibrium, left out: {len(places)} positions at a heading of {heading:g} deg, a depth of {depth:g} "
            f"mm and a skin height of {height:.2f} mm, x {left:g} to {right:g} mm, y {low:g} to {high:g} mm"
        )
    if groups:
        yield "slides over these places are not synthesized; lower [skin] height_mm or friction"


def _levels(sensor: Sensor, source: str) -> list[tuple[float, State]]:
    """Effective pressure and inflated posture of each level."""
    skin, pressures = skin_of(sensor), sensor.skin.effective_pressure_mpa
    levels: list[tuple[float, State]] = []
    for value in pressures or sensor.skin.height_mm:
        try:
            levels.append((value, skin.inflate(value)) if pressures else skin.inflate_to(value))
        except NoEquilibrium as error:
            name = "effective_pressure_mpa" if pressures else "height_mm"
            raise InputError(
                f"{source}: [skin] {name} {value:g} is beyond the skin's limit ({error}); lower it"
            ) from None
    return levels


def _solve(task: Task, *call: Any) -> tuple[Task, np.ndarray, dict[str, float]]:
    values, statistics = solve_line(*call)
    return task, values, asdict(statistics)


def _parallel(calls: list[tuple], workers: int, backend: str, scheduler: str) -> Iterator[Any]:
    """Results in the order they finish; in this process when one worker is asked for."""
    with ExitStack() as stack:
        if backend == "dask" and not scheduler:
            from distributed import Client, get_client

            try:
                client = get_client()
            except ValueError:
                client = stack.enter_context(Client(n_workers=workers, threads_per_worker=1))
            scheduler = client.scheduler_info()["address"]
        yield from results(_solve, calls, workers, scheduler, ordered=False)


def _gather(
    sensor: Sensor,
    grid: Grid,
    levels: list[tuple[float, State]],
    done: Done,
    grids: tuple[np.ndarray, ...],
) -> Atlas:
    """The lines' results on one grid, without the cells next to a position that was not solved."""
    x, y = grids[:2]
    channels = next(iter(done.values()))[0].shape[1]
    shape = (len(x), len(y), len(grid.depth_mm), len(levels))
    parts = np.zeros((3, *shape, channels), np.float32)
    valid = np.ones(shape, bool)
    heights = [skin_of(sensor).height(state) for _, state in levels]
    failed = []
    for level, depth in np.ndindex(len(levels), len(grid.depth_mm)):
        solved = {line: values for (*at, line), (values, _) in done.items() if at == [level, depth]}
        found = all_lines(solved, grids, sensor)
        parts[:, :, :, depth, level] = on_grid(found, grids)
        for line, values in found.items():
            for at in (x, y)[line.axis][np.isnan(values[:, 0])]:
                place = (at, line.offset_mm) if line.axis == 0 else (line.offset_mm, at)
                heading = HEADING_DEG[line.axis, line.sense]
                failed.append([*map(float, place), heading, grid.depth_mm[depth], heights[level]])
                near = [np.abs(g - p) <= grid.line_mm + 1e-9 for g, p in zip((x, y), place, strict=True)]
                valid[(*np.ix_(*near), depth, level)] = False
    statics = np.array([gravity(state.rotations) for _, state in levels])
    pressures = np.array([p for p, _ in levels])
    meta = _meta(sensor, grid, done, failed)
    return Atlas(x, y, np.array(grid.depth_mm), pressures, np.array(heights), statics, parts, valid, meta)


def on_grid(solved: dict[Line, np.ndarray], grids: tuple[np.ndarray, ...]) -> np.ndarray:
    """The mean and the friction parts (3, x, y, channels) of two crossing families of lines, each (n, channels).

    grids: places along x and along y, and the lines' y and x.
    """
    x, y, line_y, line_x = grids
    channels = next(iter(solved.values())).shape[1]
    along_x = np.zeros((2, len(x), len(line_y), channels))
    along_y = np.zeros((2, len(line_x), len(y), channels))
    for line, values in solved.items():
        # Zeros keep the splines finite; the cells that they reach are not valid.
        values = np.where(np.isnan(values[:, :1]), 0.0, values)
        side = (1 - line.sense) // 2
        if line.axis == 0:
            along_x[side][:, np.searchsorted(line_y, line.offset_mm - 1e-9)] = values
        else:
            along_y[side][np.searchsorted(line_x, line.offset_mm - 1e-9)] = values
    return join_families((along_x[0], along_x[1]), (along_y[0], along_y[1]), grids)


def _meta(sensor: Sensor, grid: Grid, done: Done, failed: list[list[float]]) -> dict[str, Any]:
    """What an atlas says of its origin: design, mesh, grid, cost, failures."""
    skin, boards = skin_of(sensor), len(sensor.accelerometers)
    costs = [cost for _, cost in done.values()]
    total = {name: sum(cost[name] for cost in costs) for name in asdict(Statistics())}
    # Tilts at either end of each line, where the skin must be at rest again.
    ends = [v[[0, -1], : PER_BOARD * boards].reshape(2, boards, PER_BOARD)[..., :3] for v, _ in done.values()]
    return {
        "design": design_of(sensor),
        "design_hash": design_hash(sensor),
        "reach_mm": list(reach_mm(sensor)),
        "mesh": {**asdict(sensor.mesh), "nodes": len(skin.mesh.nodes), "unknowns": skin.system.size},
        "grid": asdict(grid),
        "tolerance_n": TOLERANCE_N,
        "statistics": {**total, "lines": len(costs), "deepest_mm": max(cost["deepest_mm"] for cost in costs)},
        "rest_error_g": float(np.nanmax(np.abs(ends))),
        "failed": failed,
    }

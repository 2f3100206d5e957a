"""Unlimited training windows, drawn from a response map without touching the disk.

A slide is a straight line at any angle and offset, at a speed between 0.3 and 60 mm/s, seen from some moment on
and stopped anywhere: at the rim beyond, on the dome, or after a rest. Nothing about a recording's length, side or
travel is informative.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from softslide.features.window import WINDOW_BINS
from softslide.models.response_map.map import ResponseMap
from softslide.pipeline.ranges import POSITIVE, SHARE, SIZE, check_pairs, check_ranges
from softslide.pipeline.recordings.windows import LabelledWindows

SAMPLES = 2 * WINDOW_BINS  # of a slide before its window is cut: two a bin
TABLE_MM = 0.5  # spacing of the look-up table, a fifth of the map's splines
GRAZING_MM = 10.0  # of a line through the chamber; a shorter one only grazes the rim
BEYOND_MM = 6.0  # a slide begins and ends up to so far beyond the chamber, where the response ends at its rim
WITHIN_MM = 3.0  # and up to so far within it where it does not
MIDWAY_SHARE = 0.6  # of the chord: the latest place on the dome where a slide begins
LEAST_SEEN = 0.06  # share of a slide at which the first windows end
LONGEST_PAUSE = 0.3  # share of the slide's own time
# Lengths of the map residual's waves: well above the splines' spacing and up to the chamber's size.
WAVE_MM = (15.0, 50.0)
TRIGGER_SAMPLES = 3  # that the trigger averages
LEAST_SAMPLES = 8  # after the trigger, for a window's bins to differ
LEAST_BLOCKS = 6  # and blocks; the runtime estimates from 8 on (features/stream/conditioning.py)
LEAST_BLOCK_SHARE = 0.2  # of a block in a sample: fast slides repeat blocks, whose noise is then alike


@dataclass(frozen=True)
class SynthesisConfig:
    """Distribution of the slides (uniform unless said otherwise; seeded by the caller's generator).

    speed_mm_s: bounds, log-uniform. complete: share of slides seen to their end. paused: share that rests at the
    end. midway: share that begins on the dome, as after a stop. trigger_v: bounds of the trigger, log-uniform.
    depth_mm: standard deviation of the contact depth about the map's, normal. dead: share of windows in which an
    accelerometer is dead (of sensors that have several). channel_gain: standard deviation of each channel's gain.
    """

    speed_mm_s: tuple[float, float] = (0.3, 60.0)
    complete: float = 0.3
    paused: float = 0.08
    midway: float = 0.15
    trigger_v: tuple[float, float] = (0.0035, 0.010)
    depth_mm: float = 0.2
    dead: float = 0.25
    channel_gain: float = 0.003

    def __post_init__(self) -> None:
        check_ranges(self, speed_mm_s=POSITIVE, trigger_v=POSITIVE, depth_mm=SIZE, channel_gain=SHARE)
        check_ranges(self, complete=SHARE, paused=SHARE, midway=SHARE, dead=SHARE)
        check_pairs(self)


@dataclass(frozen=True)
class WindowBatch:
    """volts (B, C, 64) V of the channels that answer to a touch, elapsed_s (B,), weight (B, A); targets (B, 6):
    direction cos, sin, log speed, offset mm, along mm, depth mm; seen (B,): share of the slide."""

    volts: Tensor
    elapsed_s: Tensor
    weight: Tensor
    targets: Tensor
    seen: Tensor

    def labelled(self) -> LabelledWindows:
        """The same windows as of recordings, their V_z still."""
        count = len(self.elapsed_s)
        boards = self.weight.shape[1]
        axes = self.volts.shape[1] // boards
        volts = np.zeros((count, boards, 3, WINDOW_BINS), dtype=np.float32)
        volts[:, :, :axes] = self.volts.reshape(count, boards, axes, WINDOW_BINS).numpy()
        cos, sin, log_speed, offset, along, depth = self.targets.numpy().astype(float).T
        return LabelledWindows(
            volts=volts.reshape(count, -1, WINDOW_BINS),
            elapsed_s=self.elapsed_s.numpy().astype(float),
            direction_deg=np.degrees(np.arctan2(sin, cos)) % 360,
            speed_mm_s=np.exp(log_speed),
            offset_mm=offset,
            depth_mm=depth,
            along_mm=along,
            stroke_fraction=self.seen.numpy().astype(float),
            recording=np.array([f"synthetic-{n}" for n in range(count)]),
            split=np.full(count, "train"),
        )


class WindowSource:
    """Draws batches of windows from a response map."""

    def __init__(self, response: ResponseMap, block_s: float, config: SynthesisConfig) -> None:
        self.response, self.block_s, self.config = response, block_s, config
        grid = np.arange(-response.half_mm - 1, response.half_mm + 1 + TABLE_MM / 2, TABLE_MM)
        x, y = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
        right, left, up, down = (response.response(x, y, a) for a in (0.0, np.pi, np.pi / 2, -np.pi / 2))
        deeper = response.at(response.depth_mm + 1.0).response(x, y, 0.0)
        parts = [(up + down) / 2, (right - left) / 2, (up - down) / 2, deeper - right]
        if response.height_slope is not None:
            parts.append(response.at(height_mm=response.height_mm + 1.0).response(x, y, 0.0) - right)
        self._table = torch.tensor(np.concatenate(parts, axis=1), dtype=torch.float32)
        self._origin, self._size = float(grid[0]), len(grid)
        self._noise = torch.tensor(response.noise_v, dtype=torch.float32)
        self._zero = torch.tensor(response.zero_v, dtype=torch.float32)
        self._drift = torch.tensor(response.drift_v_s, dtype=torch.float32)

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        """About `count` windows (slides that never pass the trigger are left out).

        Every number is drawn whether it is used or not: the same generator gives the same windows.
        """
        random = _Random(count, generator)
        slides = self._slides(random)
        volts, depth = self._volts(slides, random)
        integral = F.pad(volts.cumsum(1), (0, 0, 1, 0))
        start, passed = self._trigger(integral, random)
        seconds = slides.seconds * (1 - start / SAMPLES)
        whole = slides.crosses & passed & (seconds > LEAST_BLOCKS * self.block_s)
        weight = self._weights(random)
        start = start.clamp(max=SAMPLES - LEAST_SAMPLES)
        windows = _bins(integral, start) * weight.repeat_interleave(self.response.axes, 1)[:, :, None]
        along, depth_mm = slides.first + slides.length, self.response.depth_mm + depth
        targets = torch.stack([*slides.heading, slides.speed.log(), slides.offset, along, depth_mm], 1)
        return WindowBatch(windows[whole], seconds[whole], weight[whole], targets[whole], slides.seen[whole])

    def _slides(self, random: "_Random") -> "_Slides":
        """Along lines at any angle and offset, which cross the chamber or not: where each slide begins, how far it is
        seen, and whether it rests at its end."""
        c, response = self.config, self.response
        angle = random.uniform(0, 2 * math.pi)
        heading = torch.stack([angle.cos(), angle.sin()])
        reach = max(response.chamber_mm) / 2 + max(abs(r) for r in response.reference_mm)
        offset = random.uniform(-reach, reach)
        low, high = c.speed_mm_s
        speed = torch.exp(random.uniform(math.log(low), math.log(high)))
        left = torch.stack([-heading[1], heading[0]])
        foot = torch.tensor(response.reference_mm)[:, None] + offset * left
        enter, leave = _crossing(foot, heading, torch.tensor(response.chamber_mm)[:, None] / 2)
        chord = leave - enter
        midway = random.chance(c.midway)
        on_the_dome = enter + random.uniform(0.0, MIDWAY_SHARE) * chord
        beyond_mm = BEYOND_MM if response.rim else -WITHIN_MM
        first = torch.where(midway, on_the_dome, enter - beyond_mm * random.uniform(0.0, 1.0))
        last = leave + beyond_mm * random.uniform(0.0, 1.0)
        complete = random.chance(c.complete)
        seen = torch.where(complete, torch.ones(random.count), random.uniform(LEAST_SEEN, 1.0))
        length = (last - first) * seen
        paused = random.chance(c.paused)
        pause = torch.where(paused, length * random.uniform(0.0, LONGEST_PAUSE), torch.zeros(random.count))
        return _Slides(heading, offset, speed, foot, chord > GRAZING_MM, first, length, pause, seen)

    def _volts(self, slides: "_Slides", random: "_Random") -> tuple[Tensor, Tensor]:
        """Output (B, SAMPLES, C) V as a device would record it, and the depth (B,) mm about the map's."""
        c, response = self.config, self.response
        share = (torch.arange(SAMPLES) + 0.5) / SAMPLES
        path_mm = (slides.length + slides.pause)[:, None]
        travelled = torch.minimum(share * path_mm, slides.length[:, None])
        s = slides.first[:, None] + travelled - (slides.speed * response.lag_s)[:, None]
        depth = c.depth_mm * random.normal(random.count).clamp(-2.0, 3.0)
        low, high = (at - response.height_mm for at in response.height_range_mm)
        # Drawn for a map over heights alone: the windows of others stay as they are.
        height = None if response.height_slope is None else random.uniform(low, high)
        places = slides.foot[:, :, None] + s * slides.heading[:, :, None]
        clean = self._response(places, slides.heading, depth, height)
        each = (random.count, 1, clean.shape[2])
        gain = (
            1 + response.gain_sd * random.normal(random.count, 1, 1) + c.channel_gain * random.normal(*each)
        )
        blocks = (slides.seconds / self.block_s / SAMPLES).clamp(min=LEAST_BLOCK_SHARE)
        # The zero is off when the slide begins, and drifts straight on.
        zero = self._zero * random.normal(*each)
        zero = zero + self._drift * random.normal(*each) * (slides.seconds[:, None] * share)[:, :, None]
        zero = zero + self._map_residual(clean, path_mm, share, random)
        noise = self._noise * blocks.rsqrt()[:, None, None]
        return gain * clean + zero + noise * random.normal(random.count, SAMPLES, clean.shape[2]), depth

    def _map_residual(self, clean: Tensor, path_mm: Tensor, share: Tensor, random: "_Random") -> Tensor:
        """The map's residual (B, SAMPLES, C) V: a smooth wave along the line, different in each channel."""
        each = (random.count, 1, clean.shape[2])
        wave = 2 * math.pi * path_mm / random.uniform(*WAVE_MM)[:, None] * share
        phase = 2 * math.pi * random.even(*each)
        peak = clean.abs().amax((1, 2))[:, None, None]
        size = (self.response.floor_v + self.response.output_share * peak) * random.normal(*each)
        return size * torch.sin(wave[:, :, None] + phase)

    def _trigger(self, integral: Tensor, random: "_Random") -> tuple[Tensor, Tensor]:
        """The sample (B,) at which each slide passes its trigger, and whether it does with enough samples left."""
        level = (integral[:, TRIGGER_SAMPLES:] - integral[:, :-TRIGGER_SAMPLES]).abs().amax(
            2
        ) / TRIGGER_SAMPLES
        low, high = self.config.trigger_v
        passed = level > torch.exp(random.uniform(math.log(low), math.log(high)))[:, None]
        start = passed.float().argmax(1)
        return start.float(), passed.any(1) & (start < SAMPLES - LEAST_SAMPLES)

    def _weights(self, random: "_Random") -> Tensor:
        """(B, A): 1, and 0 for an accelerometer that is dead."""
        boards = self.response.boards
        weight = torch.ones(random.count, boards)
        if boards > 1:
            lost = torch.randint(boards, (random.count,), generator=random.generator)
            weight[torch.arange(random.count), lost] = 1.0 - random.chance(self.config.dead).float()
        return weight

    def _response(self, places: Tensor, heading: Tensor, depth: Tensor, height: Tensor | None) -> Tensor:
        """Bilinear look-up in the table: places (2, B, n) mm -> (B, n, C) V; zero beyond the table."""
        inside = (places.abs() < -self._origin).all(0)
        cells = ((places - self._origin) / TABLE_MM).clamp(0, self._size - 1.001)
        corner = cells.long()
        fu, fv = (cells - corner)[..., None]
        at = corner[0] * self._size + corner[1]
        low = self._table[at] * (1 - fu) + self._table[at + self._size] * fu
        high = self._table[at + 1] * (1 - fu) + self._table[at + self._size + 1] * fu
        parts = (low * (1 - fv) + high * fv) * inside[..., None]
        mean, along_x, along_y, deep, *higher = parts.split(self.response.channels, dim=2)
        cos, sin = heading[:, :, None, None]
        volts = mean + cos * along_x + sin * along_y + depth[:, None, None] * deep
        return volts if height is None else volts + height[:, None, None] * higher[0]


@dataclass(frozen=True)
class _Random:
    """Draws of `count` windows at once."""

    count: int
    generator: torch.Generator

    def even(self, *shape: int) -> Tensor:
        """In [0, 1)."""
        return torch.rand(*shape, generator=self.generator)

    def uniform(self, low: float, high: float) -> Tensor:
        """(B,) in [low, high)."""
        return low + (high - low) * self.even(self.count)

    def normal(self, *shape: int) -> Tensor:
        """With mean 0 and deviation 1."""
        return torch.randn(*shape, generator=self.generator)

    def chance(self, share: float) -> Tensor:
        """(B,) bool, true with the probability `share`."""
        return self.uniform(0.0, 1.0) < share


@dataclass(frozen=True)
class _Slides:
    """heading (2, B): cos and sin of the direction. foot (2, B): of the perpendicular, mm. The others (B,) each: offset
    mm, speed mm/s; whether the line crosses the chamber by more than GRAZING_MM; where on it, mm from the foot, the
    slide begins; its length and the rest at its end, as a length, mm; and which share of the slide that is."""

    heading: Tensor
    offset: Tensor
    speed: Tensor
    foot: Tensor
    crosses: Tensor
    first: Tensor
    length: Tensor
    pause: Tensor
    seen: Tensor

    @property
    def seconds(self) -> Tensor:
        """How long the slide and the rest take."""
        return (self.length + self.pause) / self.speed


def _crossing(foot: Tensor, heading: Tensor, half_mm: Tensor) -> tuple[Tensor, Tensor]:
    """Places (B,) along lines, foot + s heading (2, B), where they enter the rectangle of half the sizes (2, 1), and
    where they leave it."""
    slope = torch.where(heading.abs() < 1e-6, torch.full_like(heading, 1e-6), heading)
    a, b = (-half_mm - foot) / slope, (half_mm - foot) / slope
    return torch.minimum(a, b).amax(0), torch.maximum(a, b).amin(0)


def _bins(integral: Tensor, start: Tensor) -> Tensor:
    """Means over 64 equal bins from sample `start` (B,) on, from (B, SAMPLES + 1, C) integrals -> (B, C, 64)."""
    step = (SAMPLES - start) / WINDOW_BINS
    edges = start[:, None] + step[:, None] * torch.arange(WINDOW_BINS + 1)
    lower = edges.long().clamp(max=SAMPLES - 1)
    share = (edges - lower)[:, :, None]
    index = lower[:, :, None].expand(-1, -1, integral.shape[2])
    at_edges = integral.gather(1, index) * (1 - share) + integral.gather(1, index + 1) * share
    return (at_edges.diff(dim=1) / step[:, None, None]).transpose(1, 2).contiguous()

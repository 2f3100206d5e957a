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

from features.window import WINDOW_BINS
from models.cnn.gauss_newton import PEAK_SHARE
from models.response_map.map import ResponseMap
from pipeline.recordings.windows import LabelledWindows

KNOTS = 2 * WINDOW_BINS
TABLE_MM = 0.5


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


@dataclass(frozen=True)
class WindowBatch:
    """volts (B, C, 64) V of the tilt channels, elapsed_s (B,), weight (B, A); targets (B, 6): direction cos, sin,
    log speed, offset mm, along mm, depth mm."""

    volts: Tensor
    elapsed_s: Tensor
    weight: Tensor
    targets: Tensor

    def labelled(self) -> LabelledWindows:
        """The same windows as of recordings, their V_z still, the stroke held to be whole."""
        count = len(self.elapsed_s)
        volts = np.zeros((count, self.volts.shape[1] // 2, 3, WINDOW_BINS), dtype=np.float32)
        volts[:, :, :2] = self.volts.reshape(count, -1, 2, WINDOW_BINS).numpy()
        cos, sin, log_speed, offset, along, depth = self.targets.numpy().astype(float).T
        return LabelledWindows(
            volts=volts.reshape(count, -1, WINDOW_BINS),
            elapsed_s=self.elapsed_s.numpy().astype(float),
            direction_deg=np.degrees(np.arctan2(sin, cos)) % 360,
            speed_mm_s=np.exp(log_speed),
            offset_mm=offset,
            depth_mm=depth,
            along_mm=along,
            stroke_fraction=np.ones(count),
            recording=np.array([f"synthetic-{n}" for n in range(count)]),
            split=np.full(count, "train"),
        )


class WindowSource:
    """Draws batches of windows from a response map."""

    def __init__(self, response: ResponseMap, block_s: float, config: SynthesisConfig) -> None:
        assert response.noise_v is not None
        assert response.drift_v is not None
        self.response, self.block_s, self.config = response, block_s, config
        grid = np.arange(-response.half_mm - 1, response.half_mm + 1 + TABLE_MM / 2, TABLE_MM)
        x, y = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
        mean = response.response(x, y, np.pi / 2) + response.response(x, y, -np.pi / 2)
        along_x = response.response(x, y, 0.0) - response.response(x, y, np.pi)
        along_y = response.response(x, y, np.pi / 2) - response.response(x, y, -np.pi / 2)
        deep = response.response(x, y, 0.0, response.depth_mm + 1.0) - response.response(x, y, 0.0)
        table = np.concatenate([mean / 2, along_x / 2, along_y / 2, deep], axis=1)
        self._table = torch.tensor(table, dtype=torch.float32)
        self._origin, self._size = float(grid[0]), len(grid)
        self._noise = torch.tensor(response.noise_v, dtype=torch.float32)
        self._drift = torch.tensor(response.drift_v, dtype=torch.float32)

    def draw(self, count: int, generator: torch.Generator) -> WindowBatch:
        """About `count` windows (slides that never pass the trigger are left out)."""
        c, response = self.config, self.response

        def uniform(low: float = 0.0, high: float = 1.0) -> Tensor:
            return low + (high - low) * torch.rand(count, generator=generator)

        def normal(*shape: int) -> Tensor:
            return torch.randn(*shape, generator=generator)

        def chance(share: float) -> Tensor:
            return uniform() < share

        heading = uniform(0, 2 * math.pi)
        cos, sin = heading.cos(), heading.sin()
        half = max(response.chamber_mm) / 2
        reach = half + max(abs(r) for r in response.reference_mm)
        offset = uniform(-reach, reach)
        speed = torch.exp(uniform(math.log(c.speed_mm_s[0]), math.log(c.speed_mm_s[1])))
        foot_x = response.reference_mm[0] - offset * sin
        foot_y = response.reference_mm[1] + offset * cos
        enter, leave = (
            _crossing(foot_x, cos, response.chamber_mm[0] / 2),
            _crossing(foot_y, sin, response.chamber_mm[1] / 2),
        )
        first, last = torch.maximum(enter[0], leave[0]), torch.minimum(enter[1], leave[1])
        sound = last - first > 10.0
        first = torch.where(
            chance(c.midway), first + uniform(0.0, 0.6) * (last - first), first - uniform(0.0, 6.0)
        )
        last = last + uniform(0.0, 6.0)
        seen = torch.where(chance(c.complete), torch.ones(count), uniform(0.06, 1.0))
        length = (last - first) * seen
        pause = torch.where(chance(c.paused), length * uniform(0.0, 0.3), torch.zeros(count))
        seconds = (length + pause) / speed
        share = (torch.arange(KNOTS) + 0.5) / KNOTS
        way = torch.minimum(share * (length + pause)[:, None], length[:, None])
        s = first[:, None] + way - (speed * response.lag_s)[:, None]
        depth = c.depth_mm * normal(count).clamp(-2.0, 3.0)
        clean = self._response(
            foot_x[:, None] + s * cos[:, None], foot_y[:, None] + s * sin[:, None], cos, sin, depth
        )
        channels = clean.shape[2]
        gain = 1 + response.gain_sd * normal(count, 1, 1) + c.channel_gain * normal(count, 1, channels)
        blocks = (seconds / self.block_s / KNOTS).clamp(min=0.2)
        zero = self._drift * normal(count, 1, channels)
        zero = zero + self._drift * normal(count, 1, channels) * (share[:, None] - 0.3)
        # What the map leaves over: a smooth wave along the line, different in each channel.
        wave = 2 * math.pi * (length + pause)[:, None] / uniform(15.0, 50.0)[:, None] * share
        phase = 2 * math.pi * torch.rand(count, 1, channels, generator=generator)
        peak = clean.abs().amax((1, 2))[:, None, None]
        left = (response.floor_v + PEAK_SHARE * peak) * normal(count, 1, channels)
        zero = zero + left * torch.sin(wave[:, :, None] + phase)
        volts = (
            gain * clean + zero + self._noise * blocks.rsqrt()[:, None, None] * normal(count, KNOTS, channels)
        )
        integral = F.pad(volts.cumsum(1), (0, 0, 1, 0))
        width = 3
        level = (integral[:, width:] - integral[:, :-width]).abs().amax(2) / width
        threshold = torch.exp(uniform(math.log(c.trigger_v[0]), math.log(c.trigger_v[1])))
        passed = level > threshold[:, None]
        start = passed.float().argmax(1)
        sound &= passed.any(1) & (start < KNOTS - 8) & (seconds * (1 - start / KNOTS) > 6 * self.block_s)
        start = start.clamp(max=KNOTS - 8).float()
        windows = _bins(integral, start)
        weight = torch.ones(count, channels // 2)
        if channels > 2:
            lost = torch.randint(channels // 2, (count,), generator=generator)
            weight[torch.arange(count), lost] = 1.0 - chance(c.dead).float()
        elapsed = seconds * (1 - start / KNOTS)
        targets = torch.stack([cos, sin, speed.log(), offset, first + length, response.depth_mm + depth], 1)
        windows = windows * weight.repeat_interleave(2, 1)[:, :, None]
        return WindowBatch(windows[sound], elapsed[sound], weight[sound], targets[sound])

    def _response(self, x: Tensor, y: Tensor, cos: Tensor, sin: Tensor, depth: Tensor) -> Tensor:
        """Bilinear look-up in the table: (B, n) positions -> (B, n, C) V; zero beyond the table."""
        inside = (x.abs() < -self._origin) & (y.abs() < -self._origin)
        u = ((x - self._origin) / TABLE_MM).clamp(0, self._size - 1.001)
        v = ((y - self._origin) / TABLE_MM).clamp(0, self._size - 1.001)
        i, j = u.long(), v.long()
        fu, fv = (u - i)[..., None], (v - j)[..., None]
        at = i * self._size + j
        low = self._table[at] * (1 - fu) + self._table[at + self._size] * fu
        high = self._table[at + 1] * (1 - fu) + self._table[at + self._size + 1] * fu
        parts = (low * (1 - fv) + high * fv) * inside[..., None]
        mean, along_x, along_y, deep = parts.chunk(4, dim=2)
        turn = (cos[:, None, None], sin[:, None, None])
        return mean + turn[0] * along_x + turn[1] * along_y + depth[:, None, None] * deep


def _crossing(foot: Tensor, slope: Tensor, half_mm: float) -> tuple[Tensor, Tensor]:
    """Places along a line where one of its coordinates, foot + s slope, crosses -half and +half."""
    slope = torch.where(slope.abs() < 1e-6, torch.full_like(slope, 1e-6), slope)
    a, b = (-half_mm - foot) / slope, (half_mm - foot) / slope
    return torch.minimum(a, b), torch.maximum(a, b)


def _bins(integral: Tensor, start: Tensor) -> Tensor:
    """Means over 64 equal bins from knot `start` (B,) to the end, from (B, KNOTS + 1, C) integrals -> (B, C, 64)."""
    step = (KNOTS - start) / WINDOW_BINS
    edges = start[:, None] + step[:, None] * torch.arange(WINDOW_BINS + 1)
    lower = edges.long().clamp(max=KNOTS - 1)
    share = (edges - lower)[:, :, None]
    index = lower[:, :, None].expand(-1, -1, integral.shape[2])
    at_edges = integral.gather(1, index) * (1 - share) + integral.gather(1, index + 1) * share
    return (at_edges.diff(dim=1) / step[:, None, None]).transpose(1, 2).contiguous()

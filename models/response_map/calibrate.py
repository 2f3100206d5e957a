"""Calibration: a response map fitted to a device's labelled slides, with the atlas (if any) as its prior.

Penalised least squares for the splines, alternated with each slide's own gain and shift along its line (the
stage's moment of start and its place are only known so well), and a lag common to all. The penalty on second
differences is what keeps the friction parts, which few headings tell apart, from bending to noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded

from features.stream.conditioning import BlockMean, Conditioning, without_lag
from models.response_map.map import MARGIN_MM, PARTS, ResponseMap, knots, splines_at
from pipeline.recordings.folder import Folder
from pipeline.recordings.stroke import stage_motion
from pipeline.sensor import Sensor

STRETCH_MM = 0.5
LEAST_DRIFT_V = 5e-4  # a static output is never known better than this
RIM_MM = 1.5  # beyond the chamber's edge by this much, the skin lies on the base and answers nothing


@dataclass(frozen=True)
class CalibrationConfig:
    """Constants of the fit, chosen on held-out calibration lines (experiments/LOG.md).

    smooth_mean, smooth_friction: penalties on second differences, per V^2, for data in units of one block's noise.
    near_prior: penalty on the distance from an atlas's prior, likewise.
    gain_sd, shift_sd_mm: priors on each slide's own gain and place.
    iterations: alternations of splines and slides.
    """

    smooth_mean: float = 0.1
    smooth_friction: float = 3.0
    near_prior: float = 0.01
    gain_sd: float = 0.03
    shift_sd_mm: float = 0.1
    iterations: int = 4

    def stiffened(self, times: float) -> "CalibrationConfig":
        """The same with every penalty on the map so many times as large."""
        return replace(
            self,
            smooth_mean=times * self.smooth_mean,
            smooth_friction=times * self.smooth_friction,
            near_prior=times * self.near_prior,
        )


@dataclass(frozen=True)
class CalibrationSlide:
    """One labelled slide as the fit sees it: m short stretches of its line.

    travelled_mm, speed_mm_s: (m,) along the line from the start; volts: (m, C) V, subtracted; blocks: how many blocks
    a stretch holds, step_s in time.
    """

    recording: str
    start_mm: tuple[float, float]
    direction_rad: float
    depth_mm: float
    travelled_mm: np.ndarray
    speed_mm_s: np.ndarray
    volts: np.ndarray
    blocks: int
    step_s: float
    rest_noise_v: np.ndarray

    @property
    def offset_key(self) -> float:
        """Signed distance (mm) of the line from the chamber's centre; tells lines of one direction apart."""
        return self.start_mm[1] * np.cos(self.direction_rad) - self.start_mm[0] * np.sin(self.direction_rad)

    def place(self, shift_mm: float, lag_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Contact positions x, y (m,) mm that the signal answers to, given the slide's shift and the lag."""
        s = self.travelled_mm - shift_mm - lag_s * self.speed_mm_s
        return (
            self.start_mm[0] + s * np.cos(self.direction_rad),
            self.start_mm[1] + s * np.sin(self.direction_rad),
        )


def calibration_slides(folder: Folder, conditioning: Conditioning) -> list[CalibrationSlide]:
    """The folder's fully labelled slides; those without start, moments or speed cannot be placed and are left out."""
    slides = []
    needed = [
        "direction_deg",
        "speed_mm_s",
        "start_x_mm",
        "start_y_mm",
        "travel_mm",
        "motion_start_s",
        "motion_end_s",
    ]
    size = round(conditioning.block_s * folder.sensor.sample_rate_hz)
    tilt = [c for c in range(len(folder.sensor.channels)) if c % 3 < 2]
    for name, row in folder.manifest.dropna(subset=needed).iterrows():
        recording = folder.load(str(name))
        blocks = BlockMean(recording.volts.shape[1], size).push(recording.volts)[:, tilt]
        time_s = recording.time_s[0] + (np.arange(len(blocks)) + 0.5) * conditioning.block_s
        level = without_lag(blocks, conditioning)
        rest = blocks[time_s < row.motion_start_s - conditioning.block_s]
        if len(rest) < 5:
            continue
        moving = (time_s > row.motion_start_s - 0.1) & (time_s < row.motion_end_s)
        duration_s = row.motion_end_s - row.motion_start_s
        travelled, speed = stage_motion(
            time_s[moving] - row.motion_start_s, row.travel_mm, row.speed_mm_s, duration_s
        )
        count = max(1, round(STRETCH_MM / row.speed_mm_s / conditioning.block_s))
        whole = len(travelled) // count * count
        slides.append(
            CalibrationSlide(
                recording=str(name),
                start_mm=(float(row.start_x_mm), float(row.start_y_mm)),
                direction_rad=float(np.deg2rad(row.direction_deg)),
                depth_mm=float(row.depth_mm),
                travelled_mm=travelled[:whole].reshape(-1, count).mean(axis=1),
                speed_mm_s=speed[:whole].reshape(-1, count).mean(axis=1),
                volts=(level[moving][:whole] - rest.mean(axis=0)).reshape(-1, count, len(tilt)).mean(axis=1),
                blocks=count,
                step_s=count * conditioning.block_s,
                rest_noise_v=np.diff(rest, axis=0).std(axis=0) / np.sqrt(2),
            )
        )
    return slides


def calibrate(
    slides: list[CalibrationSlide], prior: ResponseMap, informed: bool, config: CalibrationConfig
) -> tuple[ResponseMap, dict[str, float]]:
    """Fits the map.

    prior: where the fit starts and, if `informed` (it comes from an atlas), what it stays near.
    Returns the map, and its residual: `residual_v` (rms over the slides), `residual_share` (of each slide's largest
    output, median), `gain_sd`, `lag_s`, `slides`.
    """
    response = prior
    gains, shifts = np.ones(len(slides)), np.zeros(len(slides))
    noise = np.sqrt(np.mean([s.rest_noise_v**2 for s in slides], axis=0))
    response = replace(response, noise_v=noise)
    keep = np.ones(len(slides), dtype=bool)
    for _ in range(config.iterations):
        response = _fit_splines(
            [s for s, k in zip(slides, keep, strict=True) if k],
            gains[keep],
            shifts[keep],
            response,
            prior if informed else None,
            config,
        )
        rms, means = np.empty(len(slides)), np.empty((len(slides), response.channels))
        for i, slide in enumerate(slides):
            gains[i], shifts[i], left = fit_slide(slide, gains[i], shifts[i], response, config)
            rms[i], means[i] = np.sqrt(np.mean(left**2)), left.mean(axis=0)
        # A slide whose labels are wrong must not bend the map: it stands out by its residual.
        keep = rms < 4 * np.median(rms)
        gains /= np.mean(gains[keep])
        speeds = np.array([s.speed_mm_s.max() for s in slides])
        slope = (
            np.polyfit(speeds[keep], shifts[keep], 1)[0]
            if np.ptp(speeds[keep]) > 1 and keep.sum() > 8
            else 0.0
        )
        lag = float(response.lag_s + slope)
        shifts -= (lag - response.lag_s) * speeds
        response = replace(response, lag_s=lag)
    peaks = np.array([np.abs(s.volts).max() for s in slides])
    # A faint slide's gain is mostly noise and says nothing of how slides repeat.
    clear = keep & (peaks > 0.3 * peaks.max())
    gain_var = (np.sum((gains[clear] - 1) ** 2) + 4 * config.gain_sd**2) / (clear.sum() + 4)
    residual = float(np.sqrt(np.mean(rms[keep] ** 2)))
    drift = np.sqrt((np.sum(means[keep] ** 2, axis=0) + 4 * LEAST_DRIFT_V**2) / (keep.sum() + 4))
    response = replace(response, gain_sd=float(np.sqrt(gain_var)), floor_v=residual, drift_v=drift)
    return response, {
        "slides": float(len(slides)),
        "outliers": float((~keep).sum()),
        "residual_v": residual,
        "residual_share": float(np.median(rms / peaks)),
        "gain_sd": response.gain_sd,
        "lag_s": float(response.lag_s),
    }


def slide_residual(slide: CalibrationSlide, response: ResponseMap) -> float:
    """Rms (V) that a map leaves over of a slide, its gain and shift fitted."""
    left = fit_slide(slide, 1.0, 0.0, response, CalibrationConfig())[2]
    return float(np.sqrt(np.mean(left**2)))


def blank_map(sensor: Sensor, depth_mm: float) -> ResponseMap:
    """A map without any response: the start of a fit from recordings alone."""
    k = knots(max(sensor.chamber_mm) / 2 + MARGIN_MM)
    channels = 2 * len(sensor.accelerometers)
    return ResponseMap(
        np.zeros((PARTS, k, k, channels)),
        np.zeros((k, k, channels)),
        sensor.chamber_mm,
        sensor.reference_mm,
        depth_mm,
    )


def _tensor(x_mm: np.ndarray, y_mm: np.ndarray, half_mm: float) -> sparse.csr_matrix:
    """Rows of tensor-product splines (n, K^2), 16 entries each."""
    (i, across), (j, up) = (splines_at(place, half_mm) for place in (x_mm, y_mm))
    k = knots(half_mm)
    columns, values = k * i[:, :, None] + j[:, None, :], across[:, :, None] * up[:, None, :]
    begins = 16 * np.arange(len(i) + 1)
    return sparse.csr_matrix((values.ravel(), columns.ravel(), begins), shape=(len(i), k * k))


def _fit_splines(slides, gains, shifts, response, prior, config) -> ResponseMap:
    """One penalised least-squares solution for M, Fx, Fy with the slides' gains and shifts held."""
    k = knots(response.half_mm)
    size = k * k
    noise = float(np.median(response.noise_v))
    # Unknowns in the order place, part: the normal matrix is then a band of a few hundred.
    right = np.zeros((size, PARTS, response.channels))
    start = np.zeros_like(right) if prior is None else _by_place(prior.coefficients)
    slope = response.depth_slope.reshape(size, -1)
    grams: dict[float, sparse.csr_matrix] = {}
    for slide, gain, shift in zip(slides, gains, shifts, strict=True):
        x, y = slide.place(shift, response.lag_s)
        rows = _tensor(x, y, response.half_mm) * gain
        # What the map cannot follow limits a stretch's weight, however long it was averaged.
        weight = 1.0 / (1.0 / slide.blocks + 0.5)
        turn = _turn(slide.direction_rad)
        known = rows @ ((slide.depth_mm - response.depth_mm) * slope + np.tensordot(turn, start, (0, 1)))
        right += weight * turn[:, None] * (rows.T @ (slide.volts - known))[:, None]
        before = grams.get(slide.direction_rad, sparse.csr_matrix((size, size)))
        grams[slide.direction_rad] = before + weight * (rows.T @ rows)
    turns = (np.outer(_turn(direction), _turn(direction)) for direction in grams)
    normal = sum(sparse.kron(gram, turn) for gram, turn in zip(grams.values(), turns, strict=True))
    second = sparse.diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(k - 2, k))
    bend, line = second.T @ second, sparse.identity(k)
    rough = sparse.kron(bend, line) + sparse.kron(line, bend)
    rim = _rim_gram(response)
    scale = (noise / 1.35e-3) ** 2
    smooth = scale * np.array([config.smooth_mean, *[config.smooth_friction] * (PARTS - 1)])
    near = scale * (config.near_prior if prior is not None else 1e-6)
    normal += sparse.kron(rough, np.diag(smooth)) + sparse.kron(3 * rim, np.eye(PARTS))
    normal += sparse.kron(sparse.identity(size), np.diag(1e-3 * smooth + near))
    right -= 3 * (rim @ start.reshape(size, -1)).reshape(start.shape)
    solution = start + _solved(normal, right.reshape(PARTS * size, -1)).reshape(start.shape)
    return replace(response, coefficients=solution.reshape(k, k, PARTS, -1).transpose(2, 0, 1, 3))


def _by_place(coefficients: np.ndarray) -> np.ndarray:
    """(3, K, K, C) -> (K^2, 3, C)."""
    parts, k, _, channels = coefficients.shape
    return coefficients.transpose(1, 2, 0, 3).reshape(k * k, parts, channels)


def _solved(normal: sparse.spmatrix, right: np.ndarray) -> np.ndarray:
    """x (n, C) of A x = b, A symmetric, positive definite and banded."""
    upper = sparse.triu(normal).tocoo()
    band = int((upper.col - upper.row).max())
    stored = np.zeros((band + 1, upper.shape[0]))
    stored[band + upper.row - upper.col, upper.col] = upper.data
    return solveh_banded(stored, right, overwrite_ab=True, check_finite=False)


def _turn(direction_rad: float) -> np.ndarray:
    """Weights (3,) of M, Fx, Fy for a motion's direction."""
    return np.array([1.0, np.cos(direction_rad), np.sin(direction_rad)])


def _rim_gram(response: ResponseMap) -> sparse.csr_matrix:
    """Gram matrix (K^2, K^2) of the splines over points of the rim, where the response is known to be zero."""
    grid = np.arange(-response.half_mm, response.half_mm + 0.5, 1.0)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid, indexing="ij"))
    rim = (np.abs(x) > response.chamber_mm[0] / 2 + RIM_MM) | (
        np.abs(y) > response.chamber_mm[1] / 2 + RIM_MM
    )
    rows = _tensor(x[rim], y[rim], response.half_mm)
    return rows.T @ rows


def fit_slide(slide, gain, shift, response, config) -> tuple[float, float, np.ndarray]:
    """A slide's gain and shift (mm) given the map, by Gauss-Newton with priors; and what is left (m, C) V."""
    noise = float(np.hypot(np.median(response.noise_v) / np.sqrt(slide.blocks), 5e-4))

    def model(at: float) -> np.ndarray:
        x, y = slide.place(at, response.lag_s)
        return response.response(x, y, slide.direction_rad, slide.depth_mm)

    for _ in range(2):
        volts = model(shift)
        slope = gain * (model(shift + 0.05) - model(shift - 0.05)) / 0.1
        rows = np.stack([volts.ravel(), slope.ravel()], axis=1) / noise
        rows = np.vstack([rows, np.diag([1 / config.gain_sd, 1 / config.shift_sd_mm])])
        gaps = np.append(
            (slide.volts - gain * volts).ravel() / noise,
            [(1 - gain) / config.gain_sd, -shift / config.shift_sd_mm],
        )
        step = np.linalg.lstsq(rows, gaps, rcond=None)[0]
        gain, shift = gain + step[0], shift + step[1]
    return gain, shift, slide.volts - gain * model(shift)

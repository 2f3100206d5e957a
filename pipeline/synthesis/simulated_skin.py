"""A skin that a program touches: a robot or a stage in a simulation moves, volts come out.

`synthesize.record` is for plans that are known beforehand, and adds the vibration of rubbing and the pressure's ripple.
"""

from itertools import pairwise

import numpy as np

from softslide.pipeline.atlas.atlas import Atlas, check_atlas, read_atlas
from softslide.pipeline.sensor import Sensor
from softslide.pipeline.skin.lines import PER_BOARD
from softslide.pipeline.synthesis.board_gravity import in_tilted_sensor, upright
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.electronics import volts
from softslide.pipeline.synthesis.paths.partial_contact import partial_friction_parts, touch_depth_mm
from softslide.pipeline.synthesis.specimen import Specimen, draw_specimen
from softslide.pipeline.synthesis.synthesize import SLOW_S, sensor_of


class SimulatedSkin:
    """A specimen of a solved design; its clock counts the samples that it was asked for, at the sensor's rate.

    atlas: of the design; None: the article's. sensor: None: the article's electronics. distribution: what the specimen
    of `seed` is drawn from. specimen: one that is known.

        skin = SimulatedSkin(seed=1)
        skin.push(places_mm)  # (n, 3) mm at the samples -> (n, channels) V

    Raises:
        InputError: the atlas is of another design than the sensor.
    """

    def __init__(
        self,
        seed: int = 0,
        atlas: Atlas | None = None,
        sensor: Sensor | None = None,
        distribution: Distribution | None = None,
        specimen: Specimen | None = None,
    ) -> None:
        self._atlas, spread = atlas or read_atlas(), distribution or Distribution()
        self.sensor = sensor or sensor_of(self._atlas)
        check_atlas(self._atlas, self.sensor)
        self._specimen = specimen or draw_specimen(self.sensor, spread, seed)
        self._random = np.random.default_rng([seed, 0])
        self._repeatability = 0.0 if specimen else spread.repeatability
        self.height_mm = spread.nominal_height_mm(self._atlas)
        boards = self._atlas.boards
        self._static = self._atlas.static(self._atlas.pressure_at(self.height_mm))
        self._count, self._gain, self._touched = 0, 1.0, False
        self._place, self._friction = np.full(2, np.nan), np.zeros(2)
        self._equilibrium, self._crept, self._gravity, self._drift = np.zeros((4, boards, 3))

    def push(self, places_mm: np.ndarray) -> np.ndarray:
        """The samples (n, channels) V, in `Sensor.channels` order, while the indenter is at places (n, 3) mm.

        x and y from the chamber's middle; z of the indenter's lowest point over the flat skin's face, so that minus z
        is the depth.

        Raises:
            InputError: it is pressed deeper than the atlas goes.
        """
        places = np.asarray(places_mm, float).reshape(-1, 3)
        count, rate = len(places), self.sensor.sample_rate_hz
        if not count:
            return np.empty((0, len(self.sensor.channels)))
        # The last sample of each step; between two of them gravity changes evenly.
        steps = np.rint(np.linspace(0, count, int(np.ceil(count / (SLOW_S * rate))) + 1)).astype(int)
        x, y, z = places[steps[1:] - 1].T
        touched = -z > touch_depth_mm(x, y, self.height_mm, self._atlas)
        depth = np.where(touched, -z, self._atlas.depth_mm[0])
        parts = touched[:, None, None] * partial_friction_parts(self._atlas, x, y, depth, self.height_mm)
        known = [
            self._step(np.array([x[n], y[n]]), parts[n], bool(touched[n]), (end - begin) / rate)
            for n, (begin, end) in enumerate(pairwise(steps))
        ]
        # At each step's end, and before the first: (steps + 1, boards, 3).
        moments = np.stack([self._gravity if self._count else known[0], *known])
        self._gravity = moments[-1]
        samples = np.arange(1, count + 1)
        gravity = np.stack([np.interp(samples, steps, m) for m in moments.reshape(len(steps), -1).T])
        electronics = self._specimen.electronics
        turns = electronics.mains_hz * self._count / rate % 1.0
        self._count += count
        return volts(gravity.reshape(-1, 3, count), electronics, self._random, turns).astype(float)

    def _step(self, place_mm: np.ndarray, parts: np.ndarray, touched: bool, step_s: float) -> np.ndarray:
        """Gravity (boards, 3) g that the boards read after a step that ends with the indenter at (x, y).

        parts: mean, fx and fy there (3, channels).
        """
        specimen, boards = self._specimen, len(self._static)
        way = np.nan_to_num(place_mm - self._place)
        length = float(np.hypot(*way))
        self._place = place_mm
        if touched and not self._touched:
            self._gain = 1 + self._repeatability * self._random.standard_normal()
        self._touched = touched
        # Friction follows the motion within some way (P. R. Dahl, 1968); where nothing is touched there is none.
        held = np.exp(-length / max(specimen.friction_mm, 1e-9))
        self._friction = touched * (held * self._friction + (1 - held) * way / max(length, 1e-9))
        values = self._gain * (parts[0] + self._friction @ parts[1:])
        new = values[: PER_BOARD * boards].reshape(boards, PER_BOARD)[:, [0, 1, 6]]
        # The standard solid of `viscoelastic_lag`, exact for an equilibrium that changes evenly.
        forget = np.exp(-step_s / specimen.tau_s)
        mean = (1 - forget) * specimen.tau_s / step_s
        self._crept = forget * self._crept + (mean - forget) * self._equilibrium + (1 - mean) * new
        self._equilibrium = new
        lagging = (1 - specimen.delayed) * new + specimen.delayed * self._crept
        self._drift += specimen.drift_g * np.sqrt(step_s / 60) * self._random.standard_normal((boards, 3))
        tilt = (self._static[:, :2] + lagging[:, :2])[..., None]
        return in_tilted_sensor(tilt, lagging[:, 2:], upright((0.0, 0.0)))[..., 0] + self._drift

"""A magnetic skin that turns in the earth's field, with a magnetometer on its base: the turn is taken out."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from touched_skin import NOISE, RATE_HZ, SENSOR, write_skin

import softslide
from softslide.features.errors import InputError
from softslide.features.estimate import Contact, Estimate
from softslide.pipeline.checks.report import checked
from softslide.pipeline.recordings.base_motion import base_motion_of, without_base_motion
from softslide.pipeline.recordings.folder import Folder, Recording, write_folder
from softslide.pipeline.sensor import Accelerometer, Base
from softslide.serve.localizer import Localizer

EARTH = np.array([20.0, 0.0, -45.0])  # uT
ZERO = np.array([3.0, -8.0, 12.0])  # uT, of iron that turns along with the base
# The skin's magnetometer stands at an angle to the base's, next to iron that draws the field together.
MIXED = np.array([[1.05, 0.1, 0.0], [-0.2, 0.98, 0.05], [0.02, -0.06, 1.1]])
ROBOT = replace(SENSOR, base=Base(kind="magnetometer"))


def turning(samples: int, seed: int) -> np.ndarray:
    """(n, 3) uT: the earth's field along the axes of a base that turns about z by up to 90 degrees, and leans over."""
    draw, t = np.random.default_rng(seed), np.arange(samples) / RATE_HZ
    yaw, lean = (
        size * np.sin(2 * np.pi * t / draw.uniform(4, 9) + draw.uniform(0, 6.28)) for size in (1.6, 0.4)
    )
    x, y = EARTH[0] * np.cos(yaw), -EARTH[0] * np.sin(yaw)
    return np.stack(
        [x * np.cos(lean) - EARTH[2] * np.sin(lean), y, x * np.sin(lean) + EARTH[2] * np.cos(lean)], 1
    )


def turned(name: str, outputs: np.ndarray, field: np.ndarray, seed: int) -> Recording:
    noise = NOISE * np.random.default_rng(seed).standard_normal(field.shape)
    return Recording(
        name, np.arange(len(outputs)) / RATE_HZ, outputs + field @ MIXED.T, base_v=ZERO + field + noise
    )


def resting(samples: np.ndarray) -> np.ndarray:
    """The same outputs of the skin (n, 6), next to those of a base that rests."""
    base_v = ZERO + EARTH + NOISE * np.random.default_rng(5).standard_normal((len(samples), 3))
    return np.hstack([samples[:, :3], base_v])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Folder:
    """Slides to calibrate with on a base that rests, slides to test with on one that turns, and turns alone."""
    root = tmp_path_factory.mktemp("magnets")
    still = write_skin(root / "still", 12, 4)

    def recordings() -> Iterator[Recording]:
        for seed, name in enumerate(map(str, still.manifest.index)):
            outputs = still.load(name).volts
            field = turning(len(outputs), seed)
            yield turned(name, outputs, field if name.startswith("test") else 0 * field + EARTH, 100 + seed)
        rest = still.load("calibration-0").volts[: round(0.8 * RATE_HZ)]
        drawn = rest[np.random.default_rng(1).integers(0, len(rest), round(60 * RATE_HZ))]
        yield turned("turns", drawn, turning(len(drawn), 99), 99)

    turns = pd.DataFrame({"split": ["base"]}, index=pd.Index(["turns"], name="recording"))
    manifest = pd.concat([still.manifest.drop(columns="file"), turns])
    return write_folder(root / "lab", ROBOT, manifest, recordings())


def test_the_earths_field_is_taken_out_to_the_noise(lab: Folder) -> None:
    motion = base_motion_of(lab)
    assert motion is not None
    assert np.array(motion.gains) == pytest.approx(MIXED, abs=0.03)
    assert not np.any(motion.gravity_v)
    left = without_base_motion(lab).load("turns").volts.std(axis=0)
    assert left == pytest.approx(NOISE * np.sqrt(1 + (MIXED**2).sum(axis=1)), rel=0.05)
    assert lab.load("turns").volts.std(axis=0).max() > 8 * left.max()


def test_a_turn_is_no_touch_and_slides_on_a_turning_base_are_estimated(
    lab: Folder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    softslide.train(lab.root, tmp_path / "with", "gp", track=False)
    assert "the base moved by" in capsys.readouterr().err
    localizer = Localizer.load(tmp_path / "with")

    def estimates(samples: np.ndarray) -> list[Estimate]:
        localizer.reset()
        return localizer.push(samples)

    turning_base = lab.read("turns").samples[: round(15 * RATE_HZ)]
    touches = {}
    for name, read in (("turning", turning_base), ("as if it rested", resting(turning_base))):
        touches[name] = np.mean([one.contact is not Contact.NONE for one in estimates(read)])
    assert touches["turning"] == 0.0
    assert touches["as if it rested"] > 0.2
    for name in map(str, lab.manifest.index[lab.manifest.split == "test"]):
        moved = lab.read(name).samples
        still = resting(moved)
        still[:, :3] += (EARTH - turning(len(moved), int(name.split("-")[1]))) @ MIXED.T
        ends = [[e for e in estimates(read) if e.valid][-1] for read in (moved, still)]
        assert ends[0].direction_deg == pytest.approx(ends[1].direction_deg, abs=8.0)
        assert ends[0].offset_mm == pytest.approx(ends[1].offset_mm, abs=1.0)


def test_a_base_that_hardly_turns_is_refused(lab: Folder, tmp_path: Path) -> None:
    robot = lab.read("turns")
    assert robot.base_v is not None
    quiet = replace(
        robot,
        base_v=robot.base_v.mean(axis=0) + NOISE * np.random.default_rng(0).normal(size=robot.base_v.shape),
    )
    folder = write_folder(
        tmp_path / "quiet", ROBOT, lab.manifest.drop(columns="file").loc[["turns"]], [quiet]
    )
    with pytest.raises(InputError, match="the base hardly moves"):
        base_motion_of(folder)


def test_check_has_nothing_to_say_of_it(lab: Folder) -> None:
    assert [finding for finding in checked(lab).findings if finding.kind == "base"] == []


def test_a_magnetometer_shows_nothing_of_what_tilts_accelerometers() -> None:
    with pytest.raises(ValueError, match="does not show what tilts accelerometers"):
        replace(ROBOT, accelerometers=(Accelerometer("a0", 0.0, 0.0),))

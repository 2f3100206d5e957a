"""`SimulatedSkin` gives what `record` gives of the same motion, however it is asked."""

import numpy as np
import pytest
from article_skin import ATLAS, SENSOR

import softslide
from softslide.features.errors import InputError
from softslide.pipeline.synthesis.distribution import Distribution
from softslide.pipeline.synthesis.electronics import ElectronicsSpread, ideal_electronics
from softslide.pipeline.synthesis.motion import Stroke
from softslide.pipeline.synthesis.slide_plan import Slide
from softslide.pipeline.synthesis.specimen import Specimen
from softslide.pipeline.synthesis.synthesize import record

IDEAL = Specimen(ideal_electronics(SENSOR))
LAGGING = Specimen(IDEAL.electronics, delayed=0.3, tau_s=0.2)
HEIGHT_MM = float(np.median(ATLAS.height_mm))


def a_slide(depth_mm: float = 0.5) -> tuple[Slide, np.ndarray]:
    """A plan, and where its indenter is at each sample."""
    slide = Slide(30.0, 3.0, (-32.0, -15.0), Stroke(64.0, 8.0, 0.05), depth_mm, 0.02, HEIGHT_MM)
    time_s = np.arange(int(slide.duration_s * SENSOR.sample_rate_hz) + 1) / SENSOR.sample_rate_hz
    way = slide.stroke.at(time_s - slide.motion_start_s)[0]
    return slide, np.column_stack([*slide.places(way), np.full(len(way), -depth_mm)])


@pytest.mark.parametrize("specimen", [IDEAL, LAGGING], ids=["equilibrium", "lag"])
def test_a_slide_reads_as_its_recording_does(specimen: Specimen) -> None:
    """Within 1 % of the largest output: friction begins at the skin's rim here, with the motion there."""
    slide, places = a_slide()
    recorded = record(slide, specimen, ATLAS, np.random.default_rng(0)).volts
    simulated = softslide.SimulatedSkin(specimen=specimen).push(places)
    largest = np.abs(recorded - recorded[0]).max(axis=0)
    assert largest[:2].min() > 0.02
    off = np.abs(simulated - recorded).max(axis=0)
    assert (off <= 0.01 * largest.max() + 2 * SENSOR.adc_step_v).all()


def test_pieces_read_as_the_whole_does() -> None:
    _, places = a_slide()
    whole, parts = (softslide.SimulatedSkin(specimen=LAGGING) for _ in range(2))
    cut = [part for part in np.split(places, range(10, len(places), 70)) if len(part)]
    pieces = np.concatenate([parts.push(part) for part in cut])
    assert np.abs(whole.push(places) - pieces).max() < 1e-3


def test_untouched_it_rests_and_a_press_leaves_when_it_is_lifted() -> None:
    skin = softslide.SimulatedSkin(specimen=LAGGING)
    above = np.tile([15.0, 10.0, 10.0], (1000, 1))
    rest = skin.push(above)
    assert np.ptp(rest, axis=0).max() <= 1e-6
    down = skin.push(np.column_stack([np.full((1000, 2), (15.0, 10.0)), np.linspace(10.0, -0.5, 1000)]))
    assert np.abs(down[-1] - rest[0])[:2].max() > 0.01
    assert np.abs(skin.push(np.tile(above, (4, 1)))[-1] - rest[0]).max() <= SENSOR.adc_step_v
    assert skin.push(np.empty((0, 3))).shape == (0, 3)


def test_the_mains_run_on_from_piece_to_piece() -> None:
    """Without noise, one line at the mains' frequency holds nearly all of a specimen's pick-up."""
    spread = Distribution(electronics=ElectronicsSpread(noise=0.0))
    skin = softslide.SimulatedSkin(seed=3, distribution=spread)
    volts = np.concatenate([skin.push(np.tile([0.0, 0.0, 10.0], (130, 1))) for _ in range(80)])[:10000, 0]
    power = np.abs(np.fft.rfft((volts - volts.mean()) * np.hanning(len(volts)))) ** 2
    peak = int(power[300:1000].argmax()) + 300
    assert min(abs(peak / 10 - 50), abs(peak / 10 - 60)) < 0.15
    assert power[peak - 3 : peak + 4].sum() > 0.95 * power[400:700].sum()


def test_deeper_than_the_atlas_is_refused() -> None:
    with pytest.raises(InputError, match="depth_mm"):
        softslide.SimulatedSkin().push(np.array([[0.0, 0.0, -3.0]]))

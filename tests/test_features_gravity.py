"""Gravity keeps its length where accelerometers only tilt: V_z then follows from V_x and V_y."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softslide.features.stream.conditioning import Conditioning
from softslide.features.stream.gravity import MEMORY_S, GravityWatch
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.gravity_length import LEAST_SD_G, gravity_sd_g

USUAL = Conditioning(gravity_sd_g=0.008)
BLOCK_S = USUAL.block_s
ONE = [{"zero_g_v": 1.65, "sensitivity_v_per_g": 0.8}]
BLOCKS = round(10.0 / BLOCK_S)


def turned(angle_rad: np.ndarray, towards_rad: float, static_g: np.ndarray) -> np.ndarray:
    """(n, 3) g: the static vector turned by angles (n,) about a level axis, by Rodrigues' formula."""
    axis = np.array([-np.sin(towards_rad), np.cos(towards_rad), 0.0])
    cos, sin = np.cos(angle_rad)[:, None], np.sin(angle_rad)[:, None]
    return static_g * cos + np.cross(axis, static_g) * sin + axis * (axis @ static_g) * (1 - cos)


def watched(gravity_g: np.ndarray, static_g: np.ndarray) -> GravityWatch:
    """What is known after blocks of gravity (n, 3 A) g, of accelerometers alike."""
    accelerometers = ONE * (gravity_g.shape[1] // 3)
    watch = GravityWatch(accelerometers, USUAL)
    usable = np.ones(len(accelerometers), dtype=bool)
    for g in gravity_g:
        watch.push(1.65 + 0.8 * static_g, 0.8 * (g - static_g), usable)
    return watch


def waves(amplitude_g: float, channels: tuple[float, ...]) -> np.ndarray:
    phase = 2 * np.pi * 0.3 * BLOCK_S * np.arange(BLOCKS)
    return amplitude_g * np.sin(phase)[:, None] * np.array(channels)


@given(st.floats(0.0, 0.6), st.floats(0.0, 6.2), st.floats(-0.7, 0.7), st.floats(0.0, 6.2))
def test_a_tilt_of_any_size_keeps_it(lean: float, leans_towards: float, angle: float, towards: float) -> None:
    (static,) = turned(np.array([lean]), leans_towards, np.array([0.0, 0.0, 1.0]))
    watch = watched(turned(angle * np.linspace(0.0, 1.0, BLOCKS), towards, static), static)
    assert watch.change_g < 1e-7
    assert watch.against_g2 <= 1e-7
    assert watch.kept


UPRIGHT = np.array([0.05, 0.0, 1.0])
ALONG_X = (1.0, 0.0, 0.0)


@pytest.mark.parametrize(("amplitude_g", "kept"), [(0.03, True), (0.25, False)])
def test_a_wave_of_which_v_z_knows_nothing_is_found_where_a_tilt_would_show(
    amplitude_g: float, kept: bool
) -> None:
    """V_z of an upright accelerometer falls by half the square of V_x: a weak wave shows nothing."""
    assert watched(UPRIGHT + waves(amplitude_g, ALONG_X), UPRIGHT).kept is kept
    assert watched(turned(waves(amplitude_g, (1.0,))[:, 0], 0.0, UPRIGHT), UPRIGHT).kept


@pytest.mark.parametrize("hz", [0.3, 2.0, 5.0])
def test_a_contact_that_shakes_the_board_keeps_it_and_a_wave_next_to_it_does_not(hz: float) -> None:
    """Rubbing, whose mean over a block scatters by 0.05 g, five times what calibration slides without it do."""
    random = np.random.default_rng(0)
    shaken = turned(waves(0.2, (1.0,))[:, 0], 0.7, UPRIGHT) + random.normal(0.0, 0.05, (BLOCKS, 3))
    assert watched(shaken, UPRIGHT).kept
    along_z = 0.5 * np.sin(2 * np.pi * hz * BLOCK_S * np.arange(BLOCKS))[:, None] * np.array([0.0, 0.0, 1.0])
    assert not watched(shaken + along_z, UPRIGHT).kept


def test_v_z_may_swing_with_the_pressure_and_its_static_value_be_off() -> None:
    static = np.array([0.1, 0.0, 0.99])
    gravity = turned(waves(0.2, (1.0,))[:, 0], 0.7, static) + waves(0.008, (0.0, 0.0, 1.0))
    assert watched(gravity, static + np.array([0.0, 0.0, 0.008])).kept
    assert not watched(gravity + waves(0.1, (0.0, 0.0, 1.0)), static).kept


@pytest.mark.parametrize("off", [(0.0625, 0.0), (0.0, -0.0625), (-0.05, 0.05)])
def test_a_tilt_keeps_it_where_the_zeros_have_drifted(off: tuple[float, float]) -> None:
    """By 50 mV: static V_x and V_y are then not what gravity shows."""
    static, shift = np.array([0.09, 0.0, 0.995]), np.array([*off, 0.0])
    tilts = turned(waves(0.35, (1.0,))[:, 0], 0.8, static)
    assert watched(tilts + shift, static + shift).kept


def test_the_evidence_of_several_accelerometers_adds_up() -> None:
    wave = UPRIGHT + waves(0.15, ALONG_X)
    one = watched(wave, UPRIGHT)
    pair = watched(np.tile(wave, 2), np.tile(UPRIGHT, 2))
    assert pair.against_g2 == pytest.approx(2 * one.against_g2)
    assert pair.change_g == pytest.approx(one.change_g)


@pytest.mark.parametrize(("share", "kept"), [(0.99, False), (0.998, True)])
def test_a_supply_that_changes_in_mid_contact_is_found_until_the_next_contact(
    share: float, kept: bool
) -> None:
    """All outputs go down by 1 % at once: V_z by 24 mV, more than any contact changes it in a fifth of a second."""
    gravity = turned(waves(0.1, (1.0,))[:, 0], 0.7, UPRIGHT)
    gravity[BLOCKS // 2 :] = share * gravity[BLOCKS // 2 :] - (1.0 - share) * 1.65 / 0.8
    watch = watched(gravity, UPRIGHT)
    assert watch.kept is kept
    for _ in range(BLOCKS):
        watch.push(1.65 + 0.8 * UPRIGHT, 0.8 * (gravity[-1] - UPRIGHT), np.ones(1, dtype=bool))
    assert watch.kept is kept
    watch.begin()
    assert watch.kept


def test_it_is_forgotten_and_begins_anew() -> None:
    wave = UPRIGHT + np.repeat(waves(0.3, ALONG_X)[: BLOCKS // 3], 3, axis=0)
    watch, other = watched(wave, UPRIGHT), watched(wave, UPRIGHT)
    assert not watch.kept
    for _ in range(round(4 * MEMORY_S / BLOCK_S)):
        watch.push(1.65 + 0.8 * UPRIGHT, np.zeros(3), np.ones(1, dtype=bool))
    assert watch.kept
    other.begin()
    assert other.kept


def test_sensing_elements_of_another_kind_and_those_out_of_use_are_not_judged() -> None:
    for accelerometers, usable in (([{"kind": "magnetometer"}], True), (ONE, False)):
        watch = GravityWatch(accelerometers, USUAL)
        for change in 0.8 * waves(0.5, ALONG_X):
            watch.push(1.65 + 0.8 * UPRIGHT, change, np.array([usable]))
        assert watch.kept


def test_no_slide_of_the_folder_that_gave_the_deviation_is_refused() -> None:
    folder = read_folder(SAMPLE)
    moves_s = folder.manifest["motion_start_s"]
    slides = [(folder.load(str(name)), float(at)) for name, at in moves_s.items()]
    assert LEAST_SD_G <= gravity_sd_g(slides, folder.sensor, Conditioning()) < 0.02
    assert gravity_sd_g([], folder.sensor, Conditioning()) == Conditioning().gravity_sd_g

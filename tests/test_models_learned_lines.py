"""What models on features are fitted to: recorded windows, and windows drawn from the map that they calibrate."""

import numpy as np
import pytest
from bump_slides import bump_folder, bump_sensor, lines

from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.models.classical.gaussian_process import GpConfig, fit_gp
from softslide.models.classical.interpolation import InterpolationConfig
from softslide.models.classical.learned_lines import SharesConfig, learned_windows
from softslide.models.classical.regression import float_features
from softslide.models.fitted_model import Given
from softslide.models.held_out import mean_errors, signed_errors
from softslide.models.registry import fit_model, model_named
from softslide.pipeline.recordings.windows import labelled_windows

AXES, OFFSETS, SPEEDS = (0.0, 90.0, 180.0, 270.0), np.arange(-12.0, 13.0, 4.0), (3.0, 5.0)
DIAGONAL = lines((45.0, 160.0, 250.0), (-5.0, 2.0, 6.0), (4.0,))
SHARES = SharesConfig(recorded_share=0.3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    splits = {"calibration": lines(AXES, OFFSETS, SPEEDS), "test-diagonal": DIAGONAL}
    return bump_folder(tmp_path_factory.mktemp("learned") / "bump", bump_sensor(boards=1), splits)


@pytest.fixture(scope="module")
def learned(folder):
    return learned_windows(folder.select("calibration"), Conditioning(), SHARES, None)


def test_as_many_are_drawn_as_the_shares_say_over_all_directions(learned):
    late = learned.whole.stroke_fraction >= 0.35
    drawn = np.char.startswith(learned.whole.recording.astype(str), "synthetic")
    assert drawn[late].mean() == pytest.approx(0.7, abs=0.01)
    turned = learned.whole.direction_deg[drawn] % 90
    assert np.histogram(turned, 3, (0.0, 90.0))[0].min() > 0.25 * drawn.sum()
    assert learned.whole.speed_mm_s[drawn].max() > 2 * max(SPEEDS)


def test_a_share_that_leaves_no_room_for_drawn_windows_is_recordings_alone(folder):
    almost = learned_windows(
        folder.select("calibration"), Conditioning(), SharesConfig(recorded_share=0.9999), None
    )
    np.testing.assert_array_equal(almost.whole.volts, almost.recorded.volts)


def test_a_fold_sees_neither_its_lines_nor_a_map_of_them(learned):
    left_out = np.sum([mask for _, mask in learned.folds], axis=0)
    np.testing.assert_array_equal(left_out, 1)
    whole = set(map(bytes, learned.whole.volts))
    for seen, mask in learned.folds:
        assert not set(learned.recorded.recording[mask]) & set(seen.recording)
        drawn = np.char.startswith(seen.recording.astype(str), "synthetic")
        assert not whole & set(map(bytes, seen.volts[drawn]))


def test_drawn_windows_teach_directions_that_no_recording_has(folder, learned):
    """Direction, speed and distance of lines between the axes; and the place along them."""
    config = GpConfig(search_rows=60)
    errors = []
    for windows in (learned.recorded, learned.whole):
        model = fit_gp(windows, config)
        unseen = labelled_windows(folder.select("test"), learned.conditioning, [1.0])
        rows = model.predict(float_features(unseen))
        errors.append(mean_errors(signed_errors(rows, model.outputs, unseen), unseen))
        errors[-1]["along_mm"] = np.abs(rows[:, model.outputs.index("along_mm")] - unseen.along_mm).mean()
    for name, recorded_alone in errors[0].items():
        assert errors[1][name] < 0.6 * recorded_alone, name


def test_too_few_recordings_for_a_map_are_learnt_from_alone(folder):
    few = folder.select("test")
    learned = learned_windows(few, Conditioning(), SHARES, None)
    assert set(learned.whole.recording) <= set(few.manifest.index)
    assert len(learned.whole) == len(learned.recorded)


def test_labels_that_do_not_say_where_the_contact_was_give_no_place(folder):
    few = folder.select("test")
    few.manifest["start_x_mm"] = np.nan
    windows = learned_windows(few, Conditioning(), SharesConfig(recorded_share=1.0), None).whole
    assert fit_gp(windows, GpConfig(search_rows=60)).outputs[-1] == "offset_mm"


def test_the_interpolation_takes_no_atlas(folder):
    with pytest.raises(InputError, match="recordings alone"):
        fit_model(model_named("interpolation"), folder, InterpolationConfig(), Given(atlas=object()))

"""Features of an array of volts, without a folder and without a model."""

import numpy as np
import pytest
from streams import RATE_HZ, pass_over, still, stream

import softslide
from softslide.features.errors import InputError
from softslide.features.stream.conditioning import Conditioning
from softslide.features.vector.feature_vector import feature_matrix, feature_names
from softslide.pipeline.recordings.folder import SAMPLE, read_folder
from softslide.pipeline.recordings.windows import labelled_windows

TWO = stream(still(0.6), pass_over(1.0), still(1.0), pass_over(2.0), still(1.0))


def test_each_contact_is_a_row_of_named_features() -> None:
    table = softslide.feature_table(TWO, RATE_HZ)
    assert tuple(table.columns) == feature_names(1)
    assert table.index.name == "end_s"
    assert len(table) == 2
    assert 1.6 < table.index[0] < 2.6 < 4.6 < table.index[1] < 5.6
    # A contact that still slides is there as far as it went.
    begun = softslide.feature_table(TWO[: round(3.8 * RATE_HZ)], RATE_HZ)
    assert len(begun) == 2
    assert begun.iloc[0].equals(table.iloc[0])


def test_they_are_those_that_models_learn_from() -> None:
    folder = read_folder(SAMPLE).select("calibration")
    windows = labelled_windows(folder, Conditioning(), (1.0,))
    name = str(windows.recording[0])
    recording = folder.load(name)
    end = round(
        (folder.manifest.at[name, "motion_end_s"] - recording.time_s[0]) * folder.sensor.sample_rate_hz
    )
    table = softslide.feature_table(recording.volts[: end // 20 * 20], folder.sensor.sample_rate_hz)
    assert table.to_numpy()[-1] == pytest.approx(
        feature_matrix(windows.volts[:1], windows.elapsed_s[:1])[0], rel=1e-4
    )


def test_v_z_may_be_missing() -> None:
    whole = softslide.feature_table(TWO, RATE_HZ)
    without = softslide.feature_table(TWO[:, :2], RATE_HZ, axes=2)
    assert without.equals(whole[without.columns])
    assert len(without.columns) < len(whole.columns)


def test_nothing_that_slides_is_no_row() -> None:
    table = softslide.feature_table(stream(still(2.0)), RATE_HZ)
    assert table.shape == (0, len(feature_names(1)))


@pytest.mark.parametrize(
    "volts", [np.zeros(9), np.zeros((9, 4)), np.zeros((9, 0)), np.full((900, 3), np.nan)]
)
def test_what_is_no_signal_is_refused(volts: np.ndarray) -> None:
    with pytest.raises(InputError, match="volts"):
        softslide.feature_table(volts, RATE_HZ)

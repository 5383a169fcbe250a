"""What is too little to train on is said in the user's words."""

import numpy as np
import pytest

from ertis_daemon import training
from ertis_daemon.training_rows import TrainingRows
from ertis_detector.detection import NONE
from ertis_detector.features import NUM_FEATURES
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.errors import RecordingError

NUM_ROWS = 12


def rows(num_groups):
    """Echoes of a landmark and of none, by turns, in so many scenes."""
    return TrainingRows(
        np.zeros((NUM_ROWS, NUM_FEATURES), np.float32),
        ["r48", NONE] * (NUM_ROWS // 2),
        [f"scene {number % num_groups}" for number in range(NUM_ROWS)],
        np.zeros((NUM_ROWS, 3)),
        np.zeros((NUM_ROWS, 4)),
        np.zeros(NUM_ROWS),
        np.ones(NUM_ROWS, bool),
        np.ones(NUM_ROWS, bool),
        NUM_ROWS,
        NUM_ROWS // 2,
    )


@pytest.mark.parametrize("num_groups", [1, 2])
@pytest.mark.parametrize("calibrated", [False, True])
def test_too_few_scenes_to_leave_some_out_are_told_by_number(
    tmp_path, monkeypatch, num_groups, calibrated
):
    few = rows(num_groups)
    read = {"taught": few}
    if calibrated:
        read = {"taught": rows(4), "fresh": few}
        few.groups[:] = [f"other {group}" for group in few.groups]
    monkeypatch.setattr(training, "first_chirp", lambda paths: (DEFAULT_CHIRP, "sim"))
    monkeypatch.setattr(training, "read_rows", lambda paths, *args: read[paths[0].name])
    calibrate = [tmp_path / "fresh"] * calibrated
    said = f"^{num_groups} scenes or sessions in 12 pings, expected 3 or more"
    with pytest.raises(RecordingError, match=said):
        training.train([tmp_path / "taught"], "", 1, calibrate=calibrate)

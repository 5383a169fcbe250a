"""The simulated ping against the real one, to the limits that docs/validation.md tells."""

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_simulator.validation.pdm_checks import data_sheet_density_db
from ertis_simulator.validation.real_ping import NOISE_HZ, SHAPE_HZ, compare, figures, pooled
from ertis_simulator.validation.twin import twin

pytestmark = pytest.mark.index


@pytest.fixture(scope="module")
def recording(rtisdev_folder):
    return rtisdev_folder / "rtisdev" / "simulate.bin"


@pytest.fixture(scope="module")
def real(recording):
    return figures(np.fromfile(recording, "<u4").astype(np.uint32))


def test_the_simulated_ping_is_like_the_real_one(real):
    simulated = pooled([figures(twin(seed)) for seed in range(5)])
    off = [row for row in compare(real, simulated) if row.allowed]
    assert [row for row in off if abs(row.difference) > row.allowed] == []
    assert len(off) > 30


def test_the_real_microphones_keep_what_their_data_sheet_says(real):
    audible = real.noise_db[int(np.abs(NOISE_HZ - 9e3).argmin())]
    assert -1.0 < audible - data_sheet_density_db() < 8.0  # ultrasound begins to show


def test_the_two_strong_echoes_tell_the_same_response(real):
    apart = np.diff(real.shapes_db - real.shapes_db[:, SHAPE_HZ == 46e3], axis=0)
    assert np.abs(apart).max() < 3.5


def test_validate_holds_the_real_ping_to_the_simulated_one(recording, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    assert main(["validate", "--real", str(recording), "--images", str(tmp_path)]) == 0
    assert "ring-down" in capsys.readouterr().out
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"validation_{name}.png" for name in ("chain", "noise", "ping")}

import numpy as np
import pytest

from ertis_simulator.bound.__main__ import main
from ertis_simulator.bound.expected import Landmarks, expected, look_up
from ertis_simulator.bound.fisher import place_bound
from ertis_simulator.bound.sizes import Hypotheses, hypotheses, one_side, score
from ertis_simulator.bound.table import ARRAY, BEAM, SizeBound, read_sizes, size_rows, write_rows
from ertis_simulator.bound.templates import receiver
from ertis_simulator.errors import SceneError

RATIOS_DB = (-30.0, -10.0, 10.0)


@pytest.fixture(scope="module")
def beam():
    ear = receiver(2.0, 0.0, one_beam=True)
    return ear, hypotheses(ear)


@pytest.fixture(scope="module")
def array():
    return receiver(2.0, 0.0, one_beam=False)


@pytest.fixture(scope="module")
def array_hypotheses(array):
    return hypotheses(array)


@pytest.fixture(scope="module")
def beam_scores(beam):
    ear, all_of = beam
    return score(ear, all_of, one_side(all_of)[::4], RATIOS_DB, 5, np.random.default_rng(1))


def test_whitened_interference_has_unit_variance_in_every_direction(array):
    ear = array
    whitener = ear._whitener
    white = whitener @ ear.covariance @ np.conj(whitener).transpose(0, 2, 1)
    np.testing.assert_allclose(white, np.broadcast_to(np.eye(32), white.shape), atol=1e-8)


def test_the_ratio_of_an_echo_is_that_of_energies_after_compression(array):
    echo = array.heard(48, 0.2)
    assert array.ratio(10 * echo) == pytest.approx(100 * array.ratio(echo))
    # Interference itself, drawn with its covariance, is at 0 dB on average.
    rng = np.random.default_rng(2)
    shape = (20, *array.covariance.shape[:2])
    unit = (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)
    drawn = np.einsum("fmn,bfn->bmf", np.linalg.cholesky(array.covariance), unit, optimize=True)
    assert np.mean([array.ratio(one) for one in drawn]) == pytest.approx(1.0, rel=0.2)


def test_echoes_in_few_dimensions_are_as_strong_as_in_all(array, array_hypotheses):
    all_of = array_hypotheses
    radius, tilt = 48, all_of.tilt_rad[40]
    assert all_of.radius[40] == 1
    whole = array.whitened(array.heard(radius, tilt))
    kept = np.sum(np.abs(all_of.whitened[40]) ** 2)
    assert kept == pytest.approx(np.sum(np.abs(whole) ** 2), rel=1e-3)


def test_size_is_guessed_in_deep_clutter_and_sure_above_it(beam_scores):
    right = beam_scores.right.mean(axis=1)
    assert np.all(np.abs(right[2, 0] - 0.25) < 0.12)
    assert np.all(right[:, -1] > 0.97)
    assert beam_scores.detected.mean(axis=0)[[0, -1]] == pytest.approx([0.0, 1.0], abs=0.05)


def test_knowing_more_never_tells_less(beam_scores):
    told, level, free = beam_scores.right.mean(axis=1)
    assert np.all(told >= level - 0.05)
    assert np.all(level >= free - 0.05)
    assert told[0] + told[1] > free[0] + free[1] + 0.1


def test_all_microphones_tell_more_than_one_at_the_same_ratio(array, array_hypotheses, beam_scores):
    which = one_side(array_hypotheses)[::6]
    scores = score(array, array_hypotheses, which, RATIOS_DB, 4, np.random.default_rng(1))
    assert scores.right[2, :, 1].mean() > beam_scores.right[2, :, 1].mean() + 0.1


def test_echoes_that_are_alike_cannot_be_told_apart(beam):
    ear, all_of = beam
    alike = np.repeat(all_of.whitened[:1], len(all_of.radius), axis=0)
    same = Hypotheses(all_of.radius, all_of.tilt_rad, alike, all_of.ratio)
    scores = score(ear, same, one_side(same)[::2], (10.0,), 2, np.random.default_rng(3))
    assert scores.right.mean() == pytest.approx(0.25, abs=0.12)  # ties fall as rounding has them


def test_false_alarms_are_as_many_as_said(beam):
    ear, all_of = beam
    scores = score(ear, all_of, one_side(all_of), (-90.0,), 8, np.random.default_rng(4))
    assert scores.detected.mean() < 0.01


def test_place_is_told_better_the_stronger_the_echo(array):
    weak, strong = (place_bound(array, 58, 0.3, ratio_db) for ratio_db in (0.0, 20.0))
    np.testing.assert_allclose(np.divide(weak, strong), 10.0)
    # Some of a millimetre and hundredths of a degree: a twentieth of wavelength and of beam.
    assert 1e-5 < weak.range_m < 1e-3
    assert 1e-3 < np.rad2deg(weak.azimuth_rad) < 0.3
    assert np.rad2deg(weak.tilt_rad) < 5


def test_one_beam_has_no_direction():
    with pytest.raises(ValueError, match="all microphones"):
        place_bound(receiver(2.0, 0.0, one_beam=True), 58, 0.3)


def test_a_table_is_read_as_it_was_written(tmp_path):
    rows = list(
        size_rows(2, 1, receivers=(BEAM,), ranges_m=(2.0,), azimuths_deg=(0.0,), ratios_db=(0.0,))
    )
    assert len(rows) == 13
    write_rows(tmp_path / "bound.csv", rows)
    assert read_sizes(tmp_path / "bound.csv") == rows


def test_a_landmark_is_looked_up_between_ratios_and_tilts():
    rows = [
        SizeBound(ARRAY, 2.0, 0.0, tilt, ratio, 0.9, 0.8, 0.25 + tilt / 100 + ratio / 100, 1.0, 4)
        for tilt in (0.0, 10.0)
        for ratio in (0.0, 10.0)
    ]
    heard = Landmarks(
        ("r35",) * 4,
        np.full(4, 1.7),
        np.full(4, 12.0),
        np.array([5.0, 5.0, 30.0, 5.0]),
        np.array([4.0, -40.0, 40.0, np.nan]),
    )
    free = look_up(rows, ARRAY, heard)[:, 2]
    np.testing.assert_allclose(free, [0.34, 0.30, 0.45, 0.25])
    mean = expected(rows, ARRAY, heard)
    assert mean.free == pytest.approx(free.mean())
    assert mean.detected == pytest.approx(0.75)


def test_a_folder_without_landmarks_and_a_table_that_is_none_are_named(tmp_path, capsys):
    (tmp_path / "bound.csv").write_text("a,b\n1,2\n")
    with pytest.raises(SceneError, match="make it again"):
        read_sizes(tmp_path / "bound.csv")
    assert main(["--out", str(tmp_path), "--dataset", str(tmp_path)]) == 1
    assert "bound.csv" in capsys.readouterr().err
    write_rows(tmp_path / "bound.csv", [SizeBound(BEAM, 1, 0, 0, 0, 1, 1, 1, 1, 4)])
    assert main(["--out", str(tmp_path), "--dataset", str(tmp_path)]) == 1
    assert "no simulated landmark" in capsys.readouterr().err

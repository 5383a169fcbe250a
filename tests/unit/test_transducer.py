import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.piston import PISTON_RADIUS_M
from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.errors import SceneError
from ertis_simulator.propagation import render
from ertis_simulator.sensor_response import SensorResponse, shipped_response
from ertis_simulator.transducer import DIRECT_PATH_DB, direct_path
from ertis_simulator.validation.measure import group_delay

C_M_S = 343.2
EMITTER, MICS = np.array(EMITTER_POSITION_M), mic_positions_m()


def piston_on_axis(wavenumber, distance_m):
    """Closed form of the baffled piston's field on its axis, against 1/r far away."""
    edge = np.hypot(distance_m, PISTON_RADIUS_M)
    near = np.exp(-1j * wavenumber * distance_m) - np.exp(-1j * wavenumber * edge)
    return 2 * near / (1j * wavenumber * PISTON_RADIUS_M**2)


def field(echoes, wavenumber):
    """Sum of the piston's points at one frequency, shape (num_mics,), as in an endless baffle."""
    piston = (echoes.exponent == 0)[:, None]
    waves = echoes.gain * np.exp(-1j * wavenumber * echoes.path_m)
    return np.sum(waves, axis=0, where=piston) / 10 ** (DIRECT_PATH_DB / 20)


@pytest.mark.parametrize("frequency_hz", [20e3, 50e3, 80e3])
@pytest.mark.parametrize("distance_m", [0.03, 0.1, 1.0])
def test_the_near_field_on_the_axis_is_the_closed_form(frequency_hz, distance_m):
    wavenumber = 2 * np.pi * frequency_hz / C_M_S
    ahead = EMITTER + np.array([[distance_m, 0.0, 0.0]])
    found = field(direct_path(EMITTER, ahead, C_M_S, np.random.default_rng(0)), wavenumber)
    expected = piston_on_axis(wavenumber, distance_m)
    assert np.abs(found[0] - expected) < 0.03 * np.abs(piston_on_axis(wavenumber, 1.0)) / distance_m


def test_far_beside_the_piston_its_pattern_at_90_degrees_remains():
    from scipy.special import j1

    wavenumber = 2 * np.pi * 40e3 / C_M_S
    far = EMITTER + np.array([[0.0, 5.0, 0.0]])
    found = field(direct_path(EMITTER, far, C_M_S, np.random.default_rng(0)), wavenumber)
    x = wavenumber * PISTON_RADIUS_M
    assert np.abs(found[0]) * 5.0 == pytest.approx(abs(2 * j1(x) / x), abs=0.01)


def test_the_ring_down_falls_8_db_a_millisecond_after_the_first():
    power = np.zeros(3)
    for seed in range(20):
        echoes = direct_path(EMITTER, MICS, C_M_S, np.random.default_rng(seed))
        ringing = echoes.exponent != 0
        late_m = echoes.path_m[ringing] - np.linalg.norm(MICS - EMITTER, axis=1)
        late_ms = 1e3 * late_m.mean(axis=1) / C_M_S
        each = np.sum(echoes.gain[ringing] ** 2, axis=1)
        power += [each[(late_ms > t) & (late_ms < t + 1)].sum() for t in (1.5, 3.5, 5.5)]
    np.testing.assert_allclose(np.diff(10 * np.log10(power)), -2 * 7.7, atol=1.0)


def test_a_calibration_replaces_the_shipped_response(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text("# mine\nfrequency_hz, level_db\n20000,-6\n80000, -6  # flat\n")
    mine = SensorResponse.read(path)
    np.testing.assert_allclose(mine.amplitude(np.array([10e3, 50e3, 90e3])), 10 ** (-6 / 20))
    chirp = INCUMBENT_CHIRP.samples(450e3)
    echo = Echoes.of(np.full(4, 3.0), np.ones(4))
    silent, ideal = Air(20.0, 50.0), np.ones(4, np.complex64)
    heard = render(echo, silent, chirp, 8192, ideal, mine)
    shipped = render(echo, silent, chirp, 8192, ideal)
    ratio = np.abs(np.fft.rfft(heard[0]) / np.fft.rfft(shipped[0]))
    for frequency_hz in (30e3, 40e3, 46e3):
        expected = 10 ** (-6 / 20) / shipped_response().amplitude(np.array(frequency_hz))
        at = round(frequency_hz * 8192 / 450e3)
        assert ratio[at] == pytest.approx(expected, rel=0.02)


def test_a_calibration_with_delays_is_heard_later_where_it_says(tmp_path):
    path = tmp_path / "late.csv"
    rows = "20000,0,0\n36000,0,0\n40000,0,60\n80000,0,60\n"
    path.write_text("frequency_hz,level_db,delay_us\n" + rows)
    late = SensorResponse.read(path)
    assert late.longest_delay_s == pytest.approx(60e-6)
    chirp, air, path_m = INCUMBENT_CHIRP.samples(450e3), Air(20.0, 50.0), np.full(4, 3.0)
    heard = render(
        Echoes.of(path_m, 1 / path_m), air, chirp, 16_384, np.ones(4, np.complex64), late
    )
    bands_hz = ((28e3, 35e3), (42e3, 49e3))
    found = [group_delay(heard, chirp, path_m, air, band) for band in bands_hz]
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[1] == pytest.approx(60e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "two rows or more"),
        ("frequency_hz,level_db\n50000,0\n", "two rows or more"),
        ("50000,0\n40000,-3\n", r"odd\.csv:2: met 40000 Hz after 50000, .* rising"),
        ("-1,0\n40000,-3\n", r"odd\.csv:1: .* rising from 0 Hz"),
        ("# mine\n50000,0\n60000,nan\n", r"odd\.csv:3: met '60000,nan', expected finite"),
        ("inf,0\n60000,0\n", r"odd\.csv:1: .* finite"),
        ("50000,0\n60000,1e9\n", r"odd\.csv:2: .* within 200 dB"),
        ("50000,loud\n60000,0\n", r"odd\.csv:1: met '50000,loud', expected rows like"),
        ("50000,0\n60000\n", r"odd\.csv:2: met '60000', expected rows like"),
        ("50000,0,1,1\n60000,0,1,1\n", r"odd\.csv:1: .* rows like"),
        ("50000,0,1\n60000,0\n", r"odd\.csv:2: .* rows like"),
        ("50000,0,-1\n60000,0,1\n", r"odd\.csv:1: .* delays from 0 to 1000 us"),
        ("50000,0,1\n60000,0,nan\n", r"odd\.csv:2: .* delays from 0"),
    ],
)
def test_a_calibration_that_is_none_says_why(tmp_path, text, told):
    path = tmp_path / "odd.csv"
    path.write_text(text)
    with pytest.raises(SceneError, match=told):
        SensorResponse.read(path)


def test_a_calibration_that_is_not_there_says_so(tmp_path):
    with pytest.raises(SceneError, match="No such file"):
        SensorResponse.read(tmp_path / "none.csv")

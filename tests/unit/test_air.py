import numpy as np
import pytest

from ertis_detector.air import Air

# ISO 9613-2:1996, table 2, which prints the coefficients of ISO 9613-1 in dB/km.
OCTAVES_HZ = 1000 * 10 ** (0.3 * np.arange(-4, 4))  # exact midband frequencies, 63 Hz to 8 kHz
TABLE_DB_KM = {
    (10.0, 70.0): (0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117.0),
    (20.0, 70.0): (0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6),
    (30.0, 70.0): (0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3),
    (15.0, 20.0): (0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202.0),
    (15.0, 50.0): (0.1, 0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129.0),
    (15.0, 80.0): (0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8),
}


@pytest.mark.parametrize(("temperature_c", "humidity_percent"), TABLE_DB_KM)
def test_the_absorption_is_that_of_the_standards_table(temperature_c, humidity_percent):
    printed = TABLE_DB_KM[temperature_c, humidity_percent]
    computed = 1000 * Air(temperature_c, humidity_percent).absorption_db_m(OCTAVES_HZ)
    half_a_digit = np.where(np.array(printed) >= 100, 0.5, 0.05)
    assert np.all(np.abs(computed - printed) <= 1.02 * half_a_digit + 0.002 * np.array(printed))


@pytest.mark.parametrize(
    ("frequency_hz", "db_m"), [(1e3, 4.66e-3), (30e3, 0.94), (50e3, 1.66), (100e3, 3.28)]
)
def test_a_room_at_20_degrees_absorbs_what_the_project_reckons_with(frequency_hz, db_m):
    assert Air(20.0, 50.0).absorption_db_m(np.array([frequency_hz])) == pytest.approx(
        db_m, rel=0.02
    )


def test_the_absorption_takes_any_shape():
    frequency_hz = np.linspace(10e3, 110e3, 6).reshape(2, 3)
    absorbed = Air().absorption_db_m(frequency_hz)
    assert absorbed.shape == (2, 3)
    assert np.all(np.diff(absorbed.ravel()) > 0)


@pytest.mark.parametrize(
    ("temperature_c", "speed_m_s"), [(0.0, 331.3), (20.0, 343.2), (40.0, 354.7), (-10.0, 325.2)]
)
def test_sound_is_faster_in_warm_air(temperature_c, speed_m_s):
    assert Air(temperature_c, 0.0).speed_of_sound_m_s == pytest.approx(speed_m_s, abs=0.06)


@pytest.mark.parametrize(
    ("temperature_c", "humidity_percent", "faster"),
    [(0.0, 100.0, 1.0010), (20.0, 50.0, 1.0018), (20.0, 100.0, 1.0037), (30.0, 90.0, 1.0061)],
)
def test_sound_is_faster_in_moist_air(temperature_c, humidity_percent, faster):
    """As Cramer 1993, J. Acoust. Soc. Am. 93, 2510, has it: moist over dry."""
    moist, dry = Air(temperature_c, humidity_percent), Air(temperature_c, 0.0)
    assert moist.speed_of_sound_m_s / dry.speed_of_sound_m_s == pytest.approx(faster, abs=1e-4)


def test_what_nobody_measured_is_twenty_degrees_and_half_moist():
    assert Air.measured(None, None) == Air(20.0, 50.0)
    assert Air.measured(0.0, None) == Air(0.0, 50.0)
    assert Air.measured(None, 0.0) == Air(20.0, 0.0)

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from ertis_daemon.cli import main
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS
from ertis_driver.recording import RecordingInfo, RecordingWriter
from ertis_simulator.errors import SceneError
from ertis_simulator.validation import air_checks, dish_checks, pdm_checks, wave_checks
from ertis_simulator.validation.check import Check, as_row
from ertis_simulator.validation.measure import bits, density, group_delay, in_bands, run_shares
from ertis_simulator.validation.page import checks_table, fill, rows_table
from ertis_simulator.validation.real_ping import Row, compare, figures, pooled
from ertis_simulator.validation.twin import AIR, ECHOES, twin


@pytest.mark.parametrize("check", air_checks.checks(), ids=lambda check: check.what)
def test_air_is_that_of_the_standards(check):
    assert check.agrees, as_row(check)


@pytest.mark.parametrize("row", air_checks.PRINTED_DB_KM, ids=str)
def test_every_printed_absorption_is_met_to_its_last_digit_but_one(row):
    assert air_checks.computed_db_km(*row[:3]) == pytest.approx(row[3], rel=0.005)


def test_the_dish_of_scenes_is_that_of_boundary_elements():
    found = dish_checks.checks()
    assert [as_row(check) for check in found if not check.agrees] == []
    assert len(found) == 19


@pytest.fixture(scope="module")
def waves():
    return wave_checks.checks()


@pytest.fixture(scope="module")
def modulator():
    return pdm_checks.checks()


def test_spreading_beam_delays_and_level_are_those_of_physics(waves):
    assert [as_row(check) for check in waves if not check.agrees] == []
    assert len(waves) == 11


def test_the_modulator_is_that_of_data_sheet_and_real_ping(modulator):
    assert [as_row(check) for check in modulator if not check.agrees] == []


def test_the_data_sheets_64_db_are_134_dbfs_a_hertz_down():
    # A-weighting passes white noise up to 20 kHz as if it were some 13 kHz wide.
    assert pdm_checks.a_weighted_bandwidth_db() == pytest.approx(41.2, abs=0.5)
    assert pdm_checks.data_sheet_density_db() == pytest.approx(-134.2, abs=0.5)


def test_the_disc_added_up_in_strips_has_the_patterns_known_values():
    # 2 J1(x)/x is 0.8801 at 1, 0.5767 at 2, 0.2260 at 3, and 0 at 3.8317.
    unit = 1 / wave_checks.PISTON_RADIUS_M
    found = [wave_checks.piston_by_quadrature(unit * x, 1.0, 4000) for x in (1, 2, 3, 3.8317)]
    np.testing.assert_allclose(found, [0.8801, 0.5767, 0.2260, 0.0], atol=2e-4)


def test_density_finds_the_level_of_white_noise():
    words = np.random.default_rng(1).integers(0, 2**32, 60_000, dtype=np.uint32)
    frequency_hz, level_db = density(words)
    found = in_bands(frequency_hz, level_db, np.array([100e3, 1e6]))
    np.testing.assert_allclose(found, -10 * np.log10(2.25e6), atol=0.4)


def test_a_band_that_rings_later_is_found_to_be_as_late_as_it_is():
    chirp = INCUMBENT_CHIRP.samples(AUDIO_RATE_HZ)
    size, path_m, late_s = 16_384, np.linspace(2.0, 2.1, 32), 60e-6
    frequency_hz = np.fft.rfftfreq(size, 1 / AUDIO_RATE_HZ)
    # The phase of an echo whose delay grows from none at 42 kHz to all of it at 46.
    delay_s = path_m[:, None] / AIR.speed_of_sound_m_s + np.interp(
        frequency_hz, [42e3, 46e3], [0.0, late_s]
    )
    turn = np.exp(-2j * np.pi * np.cumsum(delay_s, axis=1) * frequency_hz[1])
    audio = np.fft.irfft(np.fft.rfft(chirp, size) * turn, size).astype(np.float32)
    found = [group_delay(audio, chirp, path_m, AIR, band) for band in ((36e3, 41e3), (47e3, 50e3))]
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    assert found[1] == pytest.approx(late_s, abs=2e-6)


def test_bits_and_runs_are_counted_by_microphone():
    words = np.tile(np.array([0, 0, 2**32 - 1, 0, 0, 0, 2**32 - 1, 2**32 - 1], np.uint32), 500)
    np.testing.assert_array_equal(bits(words)[7, :4], [-1, -1, 1, -1])
    np.testing.assert_allclose(run_shares(words), [0.25, 0.5, 0.25, 0.0], atol=1e-3)


def test_a_check_that_is_nan_does_not_agree():
    assert not Check("it", "somewhere", 1.0, float("nan"), 1.0, "dB").agrees
    assert "**exceeded**" in as_row(Check("it", "somewhere", 1.0, 3.0, 1.0, "dB"))


@pytest.fixture(scope="module")
def twins():
    return [figures(twin(seed)) for seed in range(2)]


def test_two_simulated_sonars_are_alike_as_the_comparison_sees_it(twins):
    far = [row for row in compare(*twins) if row.allowed and abs(row.difference) > row.allowed]
    # Half-words come by chance.
    assert [row for row in far if "half-words" not in row.what] == []


def test_the_twins_loudest_echoes_are_where_they_were_put(twins):
    for one in twins:
        assert np.all(np.abs(one.gains_db) < 5.0)
        assert np.all(np.abs(one.phases_deg) < 25.0)
    assert ECHOES[0].position_m()[1] < 0 < ECHOES[1].position_m()[1]


def test_pooling_keeps_the_spread_over_microphones(twins):
    both = pooled(twins)
    assert both.gains_db.shape == (2, 64)
    assert both.levels_dbfs.shape[0] == 64
    assert both.tail_dbfs == pytest.approx(np.mean([one.tail_dbfs for one in twins]))


def test_a_figure_that_is_off_shows_in_the_comparison(twins):
    quiet = dataclasses.replace(twins[0], levels_dbfs=twins[0].levels_dbfs - 10.0)
    off = [row for row in compare(twins[0], quiet) if row.allowed and abs(row.difference) > 5]
    assert len(off) == 9
    assert all("level at" in row.what for row in off)


def test_only_what_is_between_the_markers_changes():
    page = "before\n<!-- air -->\nold | 1\n<!-- end air -->\nafter"
    assert fill(page, "air", "new \\1") == "before\n<!-- air -->\nnew \\1\n<!-- end air -->\nafter"


def test_a_page_without_markers_says_which():
    with pytest.raises(SceneError, match="<!-- waves -->"):
        fill("nothing here", "waves", "table")


def test_a_row_without_limit_is_told_only():
    table = rows_table([Row("loudness", 1.0, 3.5, "dB"), Row("noise", -160.0, -151.0, "dB", 4.0)])
    assert "| loudness | 1 dB | 3.5 dB | +2.5 | told only |" in table
    assert "| noise | -160 dB | -151 dB | +9 | 4 |" in table


def test_validate_rewrites_a_page_draws_and_succeeds(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    page = tmp_path / "page.md"
    names = ("dish", "air", "waves", "modulator")
    page.write_text("\n".join(f"<!-- {name} -->\n<!-- end {name} -->" for name in names))
    assert main(["validate", "--page", str(page), "--images", str(tmp_path / "img")]) == 0
    assert "first null" in page.read_text()
    assert "first null" in capsys.readouterr().out
    (drawn,) = (tmp_path / "img").iterdir()
    assert drawn.name == "validation_chain.png"
    assert 20_000 < drawn.stat().st_size < 300_000


def test_a_page_or_a_ping_that_is_not_there_is_one_line_before_the_work(tmp_path, capsys):
    assert main(["validate", "--page", str(tmp_path / "none.md")]) == 1
    empty = tmp_path / "empty.mcap"
    with RecordingWriter(empty, RecordingInfo("live", DEFAULT_CHIRP, DEFAULT_NUM_WORDS)):
        pass
    assert main(["validate", "--real", str(empty)]) == 1
    told = capsys.readouterr()
    assert told.out == ""
    page, ping = told.err.splitlines()
    assert "cannot rewrite" in page
    assert "holds no ping" in ping


def test_the_page_tells_todays_figures(waves):
    page = (Path(__file__).parents[2] / "docs/validation.md").read_text(encoding="utf-8")
    assert fill(page, "air", checks_table(air_checks.checks())) == page
    for check in waves:
        assert f"| {check.what} |" in page
    assert "exceeded" not in page

import numpy as np
import pytest

from ertis_driver.chirp import Chirp
from ertis_driver.custom_chirp import CustomChirp, read_chirp_csv
from ertis_driver.errors import SettingsError
from ertis_driver.recording_info import RecordingInfo, from_strings, to_strings

TONE = np.sin(np.arange(100) * 0.7)


def write(tmp_path, text):
    (tmp_path / "chirp.csv").write_text(text)
    return tmp_path / "chirp.csv"


def one_column(samples):
    return "".join(f"{sample!r}\n" for sample in samples.tolist())


def two_columns(samples, rate_hz):
    return "".join(f"{i / rate_hz:.9f}, {s!r}\n" for i, s in enumerate(samples.tolist()))


def test_one_sample_a_line_is_read(tmp_path):
    chirp = read_chirp_csv(write(tmp_path, "# mine\n\n" + one_column(TONE)), 500_000)
    assert chirp == CustomChirp.from_samples(TONE, 500_000)
    np.testing.assert_array_equal(chirp.dac_codes(), np.floor(2047 * TONE + 2048))
    assert read_chirp_csv(write(tmp_path, one_column(TONE))).dac_rate_hz == 450_000


def test_a_column_of_times_gives_the_rate(tmp_path):
    path = write(tmp_path, two_columns(TONE, 400_000))
    assert read_chirp_csv(path) == CustomChirp.from_samples(TONE, 400_000)
    assert read_chirp_csv(path, 400_000).dac_rate_hz == 400_000
    with pytest.raises(SettingsError, match="its times say 400000 Hz, asked for 450000"):
        read_chirp_csv(path, 450_000)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("sample", "3: 'sample', expected a sample, or time and sample"),
        ("1.5", "3: sample 1.5, expected -1 to 1"),
        ("nan", "3: 'nan', expected"),
        ("1e999", "3: '1e999', expected"),
        ("0,0,0", "3: '0,0,0', expected"),
        ("0.1;0.2", "3: '0.1;0.2', expected"),
        ("0.1,0.2", "3: '0.1,0.2', expected as many columns as in line 1"),
        ("\0" * 1000, "3: "),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, message):
    lines = one_column(TONE).splitlines()
    lines[2] = line
    with pytest.raises(SettingsError, match=message) as caught:
        read_chirp_csv(write(tmp_path, "\n".join(lines)))
    assert "chirp.csv" in str(caught.value)


def test_uneven_times_are_named(tmp_path):
    lines = two_columns(TONE, 400_000).splitlines()
    lines[70] = f"{69.5 / 400_000},0"
    with pytest.raises(SettingsError, match=r"line 71: .* expected even steps"):
        read_chirp_csv(write(tmp_path, "\n".join(lines)))
    with pytest.raises(SettingsError, match="even steps upward"):
        read_chirp_csv(write(tmp_path, "0,0.5\n" * 64))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 DAC samples, expected 64"),
        ("0.5\n" * 63, "63 DAC samples, expected 64"),
        ("0.5\n" * 65_536, "65536 DAC samples, expected 64 to 65535"),
        ("0.5\n" * 100, "all samples of the chirp are equal"),
    ],
)
def test_a_file_of_the_wrong_size_or_of_silence_is_refused(tmp_path, text, message):
    with pytest.raises(SettingsError, match=message):
        read_chirp_csv(write(tmp_path, text))


def test_what_is_no_text_or_no_file_is_refused(tmp_path):
    (tmp_path / "chirp.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="no text"):
        read_chirp_csv(tmp_path / "chirp.csv")
    with pytest.raises(SettingsError, match="cannot read"):
        read_chirp_csv(tmp_path / "other.csv")


def test_its_name_says_what_is_emitted():
    chirp = CustomChirp.from_samples(TONE)
    assert chirp.name.startswith("custom:")
    assert chirp.name == CustomChirp.from_samples(TONE + 1e-9).name, "the same codes"
    others = [CustomChirp.from_samples(TONE[::-1]), CustomChirp.from_samples(TONE, 500_000)]
    assert chirp.name not in [other.name for other in others]
    with pytest.raises(SettingsError, match="known by its samples only"):
        Chirp.parse(chirp.name)


def test_a_recording_keeps_its_samples():
    chirp = CustomChirp.from_samples(TONE, 500_000)
    info = RecordingInfo("sim", chirp, 32_768)
    assert from_strings(to_strings(info)) == info


def test_a_sampled_sweep_sounds_like_the_sweep_at_any_rate():
    sweep = Chirp("linear", dac_rate_hz=900_000)
    sampled = CustomChirp(tuple(sweep.dac_codes().tolist()), 900_000)
    assert sampled.duration_s == sweep.duration_s
    assert sampled.samples(450_000).shape == sweep.samples(450_000).shape
    assert np.abs(sampled.samples(450_000) - sweep.samples(450_000)).max() < 0.02
    assert sampled.band_hz == pytest.approx((20e3, 80e3), abs=3e3)
    np.testing.assert_allclose(sampled.samples(900_000), sweep.samples(900_000), atol=1 / 2047)


@pytest.mark.parametrize("codes", [(4096,) * 64, (-1,) * 64, (2048.5,) * 64])
def test_codes_the_dac_does_not_have_are_refused(codes):
    with pytest.raises(SettingsError, match="expected 0 to 4095"):
        CustomChirp(codes)


def test_samples_out_of_range_are_refused():
    with pytest.raises(SettingsError, match=r"sample 3 is 1\.01, expected -1 to 1"):
        CustomChirp.from_samples(np.where(np.arange(100) == 3, 1.01, TONE))
    with pytest.raises(SettingsError, match="shape"):
        CustomChirp.from_samples(np.zeros((2, 100)))

from contextlib import suppress

import numpy as np
import pytest
import threadpoolctl

from ertis_driver.audio import PdmDecoder
from ertis_driver.audio_filter import TAPS, UNITY, bit_response
from ertis_driver.digits import CUT, SILENT, DigitReader
from ertis_driver.frame import DEFAULT_NUM_WORDS
from ertis_simulator.microphone import add_noise, to_pdm

LEAD = 39  # words of the filter before the word that an output sample belongs to


def random_words(seed, count):
    return np.random.default_rng(seed).integers(0, 2**32, count, dtype=np.uint32)


def decimated_in_int64(words):
    """What the filter gives by the textbook, in units of 1 / UNITY; int64, (32, n / 10)."""
    bits = 2 * ((words[:, None] >> np.arange(32, dtype=np.uint32)) & 1).astype(np.int64) - 1
    bits[0] = 0  # start-up garbage
    padded = np.pad(bits, ((LEAD, TAPS.size), (0, 0)))
    count = words.size // 10
    total = np.zeros((count, 32), np.int64)
    for tap, value in enumerate(TAPS):
        total += int(value) * padded[tap : tap + 10 * count : 10]
    return total.T


def response_db(frequency_hz):
    phase = np.exp(-2j * np.pi * np.outer(frequency_hz, np.arange(TAPS.size)) / 4.5e6)
    return 20 * np.log10(np.abs(phase @ TAPS) / UNITY)


@pytest.mark.parametrize("count", [10, 20, 90, 40_950, 40_960, 40_970, DEFAULT_NUM_WORDS])
def test_the_audio_is_that_of_integer_arithmetic_to_the_last_bit(count):
    words = random_words(count, count)
    decoded = PdmDecoder().decode(words)
    assert decoded.half_words_repaired == 0
    assert decoded.audio.dtype == np.float32
    assert decoded.audio.shape == (32, count // 10)
    scaled = decoded.audio.astype(np.float64) * UNITY
    np.testing.assert_array_equal(scaled, decimated_in_int64(words))


@pytest.mark.parametrize("first", [-4, 0, 7, 22])
def test_a_digit_is_ten_bits_of_one_microphone(first):
    words = random_words(9, 300)
    digits = DigitReader(num_steps=2, num_phases=3).read(words, first)
    bits = (words[:, None] >> np.arange(32, dtype=np.uint32)) & 1
    for (mic, half, phase, step), met in np.ndenumerate(digits):
        number = first + phase + 3 * step
        ten = bits[max(10 * number + 1, 0) : max(10 * number + 11, 0), mic + 16 * half]
        expected = int(ten @ (1 << np.arange(ten.size)))
        if number == 29:  # its last bit would be the next frame's
            expected += CUT
        assert met == (expected if 0 <= number <= 29 else SILENT)


def test_a_decoder_forgets_the_frame_before():
    decoder = PdmDecoder()
    decoder.decode(random_words(1, 40_000))
    words = random_words(2, 7690)
    np.testing.assert_array_equal(decoder.decode(words).audio, PdmDecoder().decode(words).audio)


def test_the_first_word_is_silence():
    words = random_words(3, 1000)
    other = words.copy()
    other[0] ^= 0xFFFFFFFF
    np.testing.assert_array_equal(
        PdmDecoder().decode(words).audio, PdmDecoder().decode(other).audio
    )


def test_the_same_bits_come_from_one_and_two_blas_threads():
    words = random_words(4, DEFAULT_NUM_WORDS)
    heard = []
    for threads in (1, 2):
        with threadpoolctl.threadpool_limits(threads, "blas"):
            heard.append(PdmDecoder().decode(words).audio)
    np.testing.assert_array_equal(*heard)


def test_the_filter_is_flat_to_100_khz():
    level_db = response_db(np.linspace(0, 100e3, 2001))
    assert np.ptp(level_db) / 2 <= 0.012


def test_what_would_fold_into_the_band_is_87_db_down():
    assert response_db(np.linspace(350e3, 2.25e6, 20_001)).max() <= -87.0


def test_float32_holds_every_partial_sum_of_the_taps():
    assert np.abs(TAPS.astype(np.int64)).sum() < 2**24
    assert TAPS.sum() == UNITY == 2**23
    np.testing.assert_array_equal(TAPS, TAPS[::-1])


@pytest.mark.parametrize("position", [1, 5, 444, 9_960, 9_999])
def test_one_turned_bit_changes_the_audio_by_its_response(position):
    words = random_words(5, 10_000)
    words[position] &= np.uint32(0xFFFFFFFE)
    other = words.copy()
    other[position] |= np.uint32(1)
    change = decimated_in_int64(other)[0] - decimated_in_int64(words)[0]
    expected = 2.0 * bit_response(position, np.arange(1000)) * UNITY
    np.testing.assert_array_equal(change, expected)


@pytest.mark.parametrize(
    "words",
    [
        np.zeros(100, np.int64),
        np.zeros(100, np.int32),
        np.zeros((10, 10), np.uint32),
        np.zeros(101, np.uint32),
    ],
)
def test_words_of_another_kind_are_refused_with_what_was_met(words):
    with pytest.raises(ValueError, match=r"expected uint32 of shape \(n,\)") as caught:
        PdmDecoder().decode(words)
    assert str(words.dtype) in str(caught.value)
    assert str(words.shape) in str(caught.value)


def test_an_empty_frame_gives_no_audio_or_is_refused_plainly():
    with suppress(ValueError):
        assert PdmDecoder().decode(np.zeros(0, np.uint32)).audio.shape == (32, 0)


@pytest.fixture(scope="module")
def pdm():
    """A quiet frame with a 40 kHz tone in it, as a sigma-delta microphone would send it."""
    rng = np.random.default_rng(6)
    tone = 0.02 * np.sin(2 * np.pi * 40e3 * np.arange(16_384) / 450e3 + np.arange(32)[:, None])
    pressure = tone.astype(np.float32)
    add_noise(pressure, rng)
    return to_pdm(pressure, rng)


@pytest.fixture(scope="module")
def planted(pdm):
    """The frame with 40 corrupt half-words, their places, and the clean frame's audio."""
    rng = np.random.default_rng(7)
    places = np.arange(12_000, 152_000, 3500) + rng.integers(0, 2000, 40)
    low_of_next = (pdm[places + 1] & np.uint32(0xFFFF)) << np.uint32(16)
    corrupt = pdm.copy()
    corrupt[places] = (pdm[places] & np.uint32(0xFFFF)) | low_of_next
    return corrupt, places, PdmDecoder().decode(pdm).audio


def test_a_clean_frame_is_left_alone(pdm):
    assert PdmDecoder().decode(pdm).half_words_repaired == 0


def test_most_corrupt_half_words_are_found(planted):
    corrupt, places, _ = planted
    assert np.count_nonzero(places) == 40
    assert PdmDecoder().decode(corrupt).half_words_repaired >= 30  # 34 to 37 of 40 were, in trials


def test_where_all_wrong_bits_are_turned_back_the_audio_is_the_clean_one_exactly(pdm, planted):
    corrupt, places, clean = planted
    mended = PdmDecoder().decode(corrupt).audio
    damaged = decimated_in_int64(corrupt) / UNITY
    bits = [(place, mic) for place in places for mic in range(16, 32)]
    wrong = [(p, m) for p, m in bits if (int(corrupt[p]) ^ int(pdm[p])) >> m & 1]
    near = {p: slice(p // 10 - 6, p // 10 + 7) for p in places}
    healed = sum(np.array_equal(mended[m, near[p]], clean[m, near[p]]) for p, m in wrong)
    left = sum(np.array_equal(mended[m, near[p]], damaged[m, near[p]]) for p, m in wrong)
    assert healed + left == len(wrong)  # a bit is mended to the last bit, or not touched
    assert healed >= 0.75 * len(wrong)
    right = [(p, m) for p, m in bits if (p, m) not in wrong]
    harmed = sum(not np.array_equal(mended[m, near[p]], clean[m, near[p]]) for p, m in right)
    assert harmed <= 0.06 * len(right)  # 3.5 % were, by chance
    np.testing.assert_array_equal(mended[:16], clean[:16])


@pytest.mark.parametrize("stuck", [0, 0xFFFFFFFF, 0xAAAAAAAA])
def test_a_frame_of_stuck_bits_is_left_alone(stuck):
    # Every word looks like a corrupt half-word there.
    words = np.full(163_840, stuck, np.uint32)
    assert PdmDecoder().decode(words).half_words_repaired == 0


def test_mending_lowers_the_click(planted):
    corrupt, _, clean = planted
    mended = PdmDecoder().decode(corrupt).audio
    damage = decimated_in_int64(corrupt) / UNITY - clean
    assert np.sum((mended - clean) ** 2) < 0.2 * np.sum(damage**2)


def test_decoding_into_given_memory_gives_the_same_and_the_wrong_memory_is_refused():
    words = np.random.default_rng(8).integers(0, 2**32, 4_000, dtype=np.uint32)
    out = np.full((32, 400), np.nan, np.float32)
    decoded = PdmDecoder().decode(words, out)
    assert decoded.audio is out
    assert np.array_equal(out, PdmDecoder().decode(words).audio)
    with pytest.raises(ValueError, match=r"expected float32 of shape \(32, 400\)"):
        PdmDecoder().decode(words, np.empty((32, 399), np.float32))

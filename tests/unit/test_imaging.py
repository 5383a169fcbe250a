import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.imaging import (
    AUDIO_RATE_HZ,
    NUM_DIRECTIONS,
    RANGE_STRIDE,
    RATE_HZ,
    Focus,
    Imager,
    MatchedFilter,
    plane,
    unit_vectors,
)
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.propagation import render

NUM_SAMPLES = 16_384
AIR = Air()
C = AIR.speed_of_sound_m_s
CHIRP = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
MICS, EMITTER = mic_positions_m(), np.array(EMITTER_POSITION_M)


def point_at(range_m, azimuth_deg=0.0, elevation_deg=0.0):
    azimuth, elevation = np.deg2rad([azimuth_deg]), np.deg2rad([elevation_deg])
    return range_m * unit_vectors(azimuth, elevation)[0]


def heard_from(*points, strength=0.05):
    """Audio of point reflectors, without noise."""
    parts = []
    for point in points:
        out, back = np.linalg.norm(point - EMITTER), np.linalg.norm(point - MICS, axis=1)
        parts.append(Echoes.of(out + back, strength / (out * back)))
    mics = np.ones(32, np.complex64)
    return render(Echoes.join(parts), AIR, CHIRP, NUM_SAMPLES, mics)


@pytest.fixture(scope="module")
def matched():
    return MatchedFilter(CHIRP, NUM_SAMPLES, (20e3, 80e3))


@pytest.fixture(scope="module")
def imager(matched):
    return Imager(MICS, matched.baseband, C, *plane())


@pytest.fixture(scope="module")
def focus(matched):
    return Focus(MICS, EMITTER, matched.baseband, C)


def peak_of(scape):
    direction, cell = np.unravel_index(scape.power.argmax(), scape.power.shape)
    return float(scape.range_m[cell]), float(np.rad2deg(scape.azimuth_rad[direction]))


def test_directions_are_forward_left_and_up():
    quarter = np.pi / 2
    np.testing.assert_allclose(unit_vectors(np.array(0.0), np.array(0.0)), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(unit_vectors(np.array(quarter), np.array(0.0)), [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(unit_vectors(np.array(0.3), np.array(quarter)), [0, 0, 1], atol=1e-9)
    assert unit_vectors(np.zeros(5), np.array(0.1)).shape == (5, 3)


@pytest.mark.parametrize("range_m", [0.7, 1.5, 3.0, 5.5])
@pytest.mark.parametrize("azimuth_deg", [0.0, 20.0, -45.0])
def test_a_point_peaks_at_its_own_cell(matched, imager, range_m, azimuth_deg):
    point = point_at(range_m, azimuth_deg)
    found_m, found_deg = peak_of(imager(matched(heard_from(point))))
    # The image counts the way as twice the range; the emitter sits off the centre.
    way_m = np.linalg.norm(point - EMITTER) + np.linalg.norm(point)
    cell_m = RANGE_STRIDE / RATE_HZ * C / 2
    assert found_m == pytest.approx(way_m / 2, abs=cell_m)
    steps = np.sin(np.deg2rad(found_deg)) - np.sin(np.deg2rad(azimuth_deg))
    assert abs(steps) <= 1.01 * 2 * np.sin(np.deg2rad(60)) / (NUM_DIRECTIONS - 1)


def test_left_is_positive(matched, imager):
    assert peak_of(imager(matched(heard_from(np.array([2.0, 1.0, 0.0])))))[1] > 20


def test_the_image_covers_what_it_says_it_covers(imager, matched):
    scape = imager(matched(heard_from(point_at(2.0))))
    assert scape.power.shape == (91, scape.range_m.size)
    assert scape.power.dtype == np.float32
    assert np.all(np.diff(scape.azimuth_rad) > 0)
    np.testing.assert_allclose(np.rad2deg(scape.azimuth_rad[[0, 45, 90]]), [-60, 0, 60], atol=1e-9)
    np.testing.assert_allclose(np.diff(scape.range_m), RANGE_STRIDE / RATE_HZ * C / 2)
    assert scape.range_m[0] >= 0.5
    # As far as the whole chirp returns within the frame.
    heard_m = (NUM_SAMPLES - CHIRP.size) / AUDIO_RATE_HZ * C / 2
    assert scape.range_m[-1] == pytest.approx(heard_m, abs=0.03)


def test_the_matched_filter_correlates(matched):
    """Against the textbook: the analytic chirp's correlation in float64, resampled by FFT."""
    audio = heard_from(point_at(2.0))[:2].astype(np.float64)
    frequency = np.fft.fftfreq(NUM_SAMPLES, 1 / AUDIO_RATE_HZ)
    edge = np.minimum(frequency - 20e3, 80e3 - frequency)
    band = np.sin(np.pi / 2 * np.clip(edge / 5e3, 0, 1)) ** 2
    weight = np.conj(np.fft.fft(CHIRP, NUM_SAMPLES)) * band
    spectrum = np.fft.fft(audio, axis=1) * weight
    found = matched(heard_from(point_at(2.0)))[:2]
    assert found.shape == (2, matched.baseband.num_samples)
    inside = np.flatnonzero(band)
    time_s = np.arange(found.shape[1]) / RATE_HZ
    turn = np.exp(2j * np.pi * np.outer(frequency[inside] - matched.baseband.carrier_hz, time_s))
    baseband = spectrum[:, inside] @ turn
    likeness = np.abs(np.vdot(found, baseband)) ** 2
    likeness /= np.vdot(found, found).real * np.vdot(baseband, baseband).real
    assert likeness > 0.9999
    assert abs(np.angle(np.vdot(found, baseband))) < 1e-3


def test_white_noise_comes_out_of_the_filter_as_strong_as_it_went_in(matched):
    noise = np.random.default_rng(1).standard_normal((32, NUM_SAMPLES)).astype(np.float32)
    out = matched(noise)
    inner = np.abs(out[:, 1200:-1200]) ** 2
    assert out.dtype == np.complex64
    assert inner.mean() == pytest.approx(1.0, rel=0.05)


def test_noise_alone_is_one_32nd_in_the_image(matched, imager):
    rng = np.random.default_rng(2)
    scape = imager(matched(rng.standard_normal((32, NUM_SAMPLES)).astype(np.float32)))
    assert scape.power[:, 100:-100].mean() == pytest.approx(1 / 32, rel=0.1)
    assert scape.noise_floor == pytest.approx(1 / 32, rel=0.2)


def test_the_direct_path_and_the_start_of_the_frame_leave_no_echo_at_its_end(matched):
    audio = np.zeros((32, NUM_SAMPLES), np.float32)
    audio[:, : CHIRP.size] = CHIRP
    echo = np.abs(matched(np.roll(audio, 4000, 1))).max()
    assert np.abs(matched(audio)).max() < 0.05 * echo
    assert np.abs(matched(audio)[:, -750:]).max() < 1e-3 * echo


def test_the_last_whole_chirp_of_a_frame_is_heard(matched):
    audio = np.zeros((32, NUM_SAMPLES), np.float32)
    first = NUM_SAMPLES - CHIRP.size
    audio[:, first:] = CHIRP
    compressed = np.abs(matched(audio)[0])
    assert compressed.argmax() == pytest.approx(first * RATE_HZ / AUDIO_RATE_HZ, abs=1)
    middle = np.abs(matched(np.roll(audio, -4000, 1))[0]).max()
    assert compressed.max() == pytest.approx(middle, rel=0.05)


def test_a_chirp_cut_by_the_end_of_the_frame_does_not_appear_in_the_image(matched, imager):
    audio = np.zeros((32, NUM_SAMPLES), np.float32)
    audio[:, -600:] = CHIRP[:600]
    power = imager(matched(audio)).power
    whole = imager(matched(np.roll(audio, -4000, 1))).power
    assert power[:, :-60].max() < 1e-4 * whole.max()


def delay_and_sum(audio, azimuth_rad, cells_s):
    """One direction of the image by the textbook: far field, exact delays, float64."""
    frequency = np.arange(NUM_SAMPLES // 2 + 1) * AUDIO_RATE_HZ / NUM_SAMPLES
    edge = np.minimum(frequency - 20e3, 80e3 - frequency)
    band = np.sin(np.pi / 2 * np.clip(edge / 5e3, 0, 1)) ** 2
    weight = np.conj(np.fft.rfft(CHIRP, NUM_SAMPLES)) * band
    kept = np.flatnonzero(band > 0)
    spectrum = np.fft.rfft(audio.astype(np.float64), axis=1)[:, kept] * weight[kept]
    early_s = MICS @ unit_vectors(np.array(azimuth_rad), np.array(0.0)) / C
    aligned = spectrum * np.exp(-2j * np.pi * frequency[kept] * early_s[:, None])
    return np.exp(2j * np.pi * np.outer(cells_s, frequency[kept])) @ aligned.mean(axis=0)


def test_the_image_is_that_of_exact_delay_and_sum(matched, imager):
    audio = heard_from(point_at(1.2, 15.0), point_at(2.0, -30.0), point_at(2.4, 40.0))
    scape = imager(matched(audio))
    chosen = np.flatnonzero((scape.range_m > 1.0) & (scape.range_m < 2.7))
    errors, exact = [], []
    for direction in (10, 18, 45, 58, 70, 85):
        cells_s = 2 * scape.range_m[chosen] / C
        exact.append(np.abs(delay_and_sum(audio, scape.azimuth_rad[direction], cells_s)))
        errors.append(np.sqrt(scape.power[direction, chosen]))
    found, exact = np.array(errors), np.array(exact)
    found *= np.sum(found * exact) / np.sum(found**2)  # the scale is the filter's own
    assert 20 * np.log10(np.abs(found - exact).max() / exact.max()) <= -30.0


def test_focus_knows_the_way_there_and_back(focus):
    points = np.stack([point_at(1.0, 30.0), point_at(3.0, -10.0, 20.0)])
    for row, point in zip(focus.delays_s(points), points, strict=True):
        way = np.linalg.norm(point - EMITTER) + np.linalg.norm(point - MICS, axis=1)
        np.testing.assert_allclose(row, way / C, rtol=1e-6)


def band_limited_noise(info, seed):
    """Complex64, shape (32, num_samples), and its spectrum; silent near both ends."""
    rng = np.random.default_rng(seed)
    shape = (32, info.num_samples)
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    frequency = np.fft.fftfreq(info.num_samples, 1 / RATE_HZ)
    spectrum = np.fft.fft(noise, axis=1) * (np.abs(frequency) < info.half_band_hz)
    return np.fft.ifft(spectrum, axis=1).astype(np.complex64), spectrum, frequency


@pytest.mark.parametrize(("before", "length"), [(20, 41), (192, 384), (0, 7)])
def test_a_beam_is_the_sum_of_the_delayed_microphones(focus, before, length):
    baseband, spectrum, frequency = band_limited_noise(focus.info, 3)
    points = np.stack([point_at(0.8, 30.0), point_at(3.0, -10.0, 20.0), point_at(5.0, 0.0)])
    beams = focus.beam(baseband, points, before, length)
    assert beams.shape == (3, length)
    assert beams.dtype == np.complex64
    for beam, point in zip(beams, points, strict=True):
        way = np.linalg.norm(point - EMITTER) + np.linalg.norm(point - MICS, axis=1)
        delays = way[:, None] / C
        turned = spectrum * np.exp(2j * np.pi * (frequency + focus.info.carrier_hz) * delays)
        exact = np.fft.ifft(turned.mean(axis=0))
        expected = np.roll(exact, before)[:length]
        error = np.sqrt(np.mean(np.abs(beam - expected) ** 2))
        # White noise adds up by its power only: a reflector's beam is 15 dB stronger.
        assert 20 * np.log10(error / np.sqrt(np.mean(np.abs(exact) ** 2))) < -15.0


def test_a_beam_that_begins_before_the_frame_begins_with_silence(focus):
    baseband, _, _ = band_limited_noise(focus.info, 4)
    early = focus.beam(baseband, point_at(0.3)[None], 400, 600)[0]
    later = focus.beam(baseband, point_at(0.3)[None], 0, 200)[0]
    assert not early[:100].any()
    np.testing.assert_allclose(early[400:], later, atol=1e-5)


def test_a_beam_beyond_the_frame_is_silent(focus):
    baseband = np.ones((32, focus.info.num_samples), np.complex64)
    assert not focus.beam(baseband, point_at(9.0)[None], 20, 41).any()
    early = focus.beam(baseband, point_at(0.2)[None], 700, 100)
    assert not early.any()


def test_a_beam_focused_on_a_reflector_peaks_at_its_own_two_way_time(matched, focus):
    point = point_at(0.9, 10.0, 15.0)
    baseband = matched(heard_from(point))
    beam = np.abs(focus.beam(baseband, point[None], 40, 81)[0])
    assert abs(int(beam.argmax()) - 40) <= 1
    aside = np.abs(focus.beam(baseband, point_at(0.9, 30.0, 15.0)[None], 40, 81)[0])
    assert aside.max() < 0.5 * beam.max()

"""The paper's pipeline: what it sees of a ping, and what its SVM makes of that."""

import dataclasses

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.detection import NONE
from ertis_detector.errors import EvaluationError
from ertis_detector.method import KnownRangePing
from ertis_detector.paper import BAND_HZ, PaperMethod, paper_features
from ertis_detector.paper_choices import ALTERNATIVES, PaperChoices, alternatives

RATE_HZ = 450_000
RANGE_M = 1.5
MICS_M = np.column_stack([np.zeros(8), np.linspace(-0.06, 0.06, 8), np.tile([-0.02, 0.02], 4)])
CHIRP = np.sin(2 * np.pi * 55e3 * np.arange(225) / RATE_HZ)
BIN_HZ = np.linspace(*BAND_HZ, 21)


def ping(audio, **changes):
    known = KnownRangePing(
        audio=np.asarray(audio, np.float32),
        range_m=RANGE_M,
        azimuth_rad=0.0,
        air=Air(),
        chirp=CHIRP,
        chirp_band_hz=(50e3, 60e3),
        chirp_name="test",
        mic_positions_m=MICS_M,
        emitter_position_m=np.zeros(3),
    )
    return dataclasses.replace(known, **changes)


def echo(at_sample, frequency_hz=55e3, length=300, num_mics=8, num_samples=8000):
    audio = np.zeros((num_mics, num_samples))
    t = np.arange(length) / RATE_HZ
    audio[:, at_sample : at_sample + length] = np.sin(2 * np.pi * frequency_hz * t)
    return audio


def middle(temperature_c=20.0, range_m=RANGE_M):
    return round(2 * range_m / Air(temperature_c).speed_of_sound_m_s * RATE_HZ)


@pytest.mark.parametrize("frequency_hz", [33e3, 55e3, 80e3, 97e3])
def test_a_tone_is_seen_in_its_bin_among_twenty(frequency_hz):
    bins = paper_features(ping(echo(middle() - 150, frequency_hz)), PaperChoices())
    assert bins.shape == (20,)
    assert bins.argmax() == np.searchsorted(BIN_HZ, frequency_hz) - 1


def test_sound_farther_than_twenty_centimetres_from_the_label_is_not_seen():
    near = paper_features(ping(echo(middle() - 150)), PaperChoices(taper="none"))
    for shift in (-513 - 300, 513):
        far = paper_features(ping(echo(middle() + shift)), PaperChoices(taper="none"))
        assert far.max() < 1e-9 * near.max()
    inside = paper_features(ping(echo(middle() + 400)), PaperChoices(taper="none"))
    assert inside.max() > 0.1 * near.max()


def test_the_crop_goes_with_the_temperature():
    cold = echo(middle(-10.0, 4.0) - 150, num_samples=16000)
    right = paper_features(ping(cold, air=Air(-10.0), range_m=4.0), PaperChoices())
    wrong = paper_features(ping(cold, air=Air(40.0), range_m=4.0), PaperChoices())
    assert wrong.max() < 0.5 * right.max()


def test_a_label_outside_the_ping_is_refused():
    with pytest.raises(EvaluationError, match=r"range 30 m lies outside a ping of 3\.06 m"):
        paper_features(ping(echo(2000), range_m=30.0), PaperChoices())


def test_a_fragment_over_the_pings_end_is_filled_with_silence():
    c = Air(20.0).speed_of_sound_m_s
    last_m = 7990 / RATE_HZ * c / 2
    assert np.isfinite(paper_features(ping(echo(7600), range_m=last_m), PaperChoices())).all()


def test_the_band_pass_takes_half_the_power_at_its_edges_and_none_inside():
    for frequency_hz, share in ((30.2e3, 0.71), (60e3, 1.0), (99.8e3, 0.71)):
        heard = ping(echo(middle() - 600, frequency_hz, 1200))
        passed, plain = (
            paper_features(heard, PaperChoices(filter_order=order)).max() for order in (4, 0)
        )
        assert passed / plain == pytest.approx(share, abs=0.05)


def test_one_microphone_their_mean_and_their_beam_hear_differently():
    audio = echo(middle() - 150)
    audio[3] *= 5
    of = {
        name: paper_features(ping(audio), PaperChoices(microphone=name))
        for name in ("3", "4", "mean")
    }
    np.testing.assert_allclose(of["3"], 5 * of["4"], rtol=1e-6)
    np.testing.assert_allclose(of["mean"], of["4"] * 12 / 8, rtol=1e-6)
    with pytest.raises(EvaluationError, match="microphone 8, expected 0 to 7"):
        paper_features(ping(audio), PaperChoices(microphone="8"))


def test_the_beam_hears_what_its_label_points_at_and_little_else():
    azimuth_rad, c = 0.35, Air(20.0).speed_of_sound_m_s
    source = RANGE_M * np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    late_s = (RANGE_M + np.linalg.norm(source - MICS_M, axis=1)) / c
    t = np.arange(8000) / RATE_HZ - late_s[:, None]
    audio = np.where(np.abs(t) < 3e-4, np.sin(2 * np.pi * 55e3 * t), 0.0)
    choices = PaperChoices(microphone="beam")
    toward = paper_features(ping(audio, azimuth_rad=azimuth_rad), choices)
    alone = paper_features(ping(audio, azimuth_rad=azimuth_rad), PaperChoices(microphone="2"))
    away = paper_features(ping(audio, azimuth_rad=-azimuth_rad), choices)
    assert toward.max() == pytest.approx(alone.max(), rel=0.02)
    assert away.max() < 0.5 * toward.max()
    with pytest.raises(EvaluationError, match="needs the label's azimuth"):
        paper_features(ping(audio, azimuth_rad=float("nan")), choices)


def test_compression_gathers_the_chirp_at_the_label():
    audio = np.zeros((8, 8000))
    audio[:, middle() : middle() + CHIRP.size] = CHIRP
    raw = paper_features(ping(audio), PaperChoices())
    compressed = paper_features(ping(audio), PaperChoices(sound="compressed"))
    assert compressed.argmax() == raw.argmax() == np.searchsorted(BIN_HZ, 55e3) - 1
    # A Hann taper passes what lies in the middle whole; half the raw chirp lies off it.
    assert compressed.max() > 2 * raw.max()


def test_magnitude_spreading_and_bins_are_as_they_are_called():
    heard = ping(echo(middle() - 150))
    plain = paper_features(heard, PaperChoices())
    undone = paper_features(heard, PaperChoices(spreading="undone"))
    np.testing.assert_allclose(undone, plain * RANGE_M**2)
    decibel = paper_features(heard, PaperChoices(magnitude="db"))
    np.testing.assert_allclose(decibel, 20 * np.log10(plain), rtol=1e-9)
    power = paper_features(heard, PaperChoices(magnitude="power"))
    assert (power >= plain**2 * (1 - 1e-12)).all()  # a mean of squares is no less than its square
    assert paper_features(heard, PaperChoices(num_bins=64)).shape == (64,)
    assert paper_features(heard, PaperChoices(binning="point")).argmax() == pytest.approx(7, abs=1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tapper=hann", "did you mean taper?"),
        ("taper=wide", "taper 'wide', expected one of hann, hamming, tukey, none"),
        ("taper", "expected NAME=VALUE"),
        ("penalty=much", "expected a number"),
        ("penalty=0", "penalty 0.0, expected 1e-06 to 100"),
        ("num_bins=1", "num_bins 1, expected 2 to 128"),
        ("microphone=-1", "microphone '-1', expected mean, sum, beam or a number"),
    ],
)
def test_a_choice_that_does_not_exist_is_refused_in_one_line(text, said):
    with pytest.raises(EvaluationError, match=said.replace("?", r"\?")) as refused:
        PaperChoices().changed([text])
    assert "\n" not in str(refused.value)


def test_every_choice_is_swept_one_at_a_time():
    default = PaperChoices()
    found = alternatives(default)
    assert {one.difference(default).partition("=")[0] for one in found} == {
        field.name for field in dataclasses.fields(PaperChoices)
    }
    assert all("," not in one.difference(default) for one in found)
    assert set(ALTERNATIVES) == {field.name for field in dataclasses.fields(PaperChoices)}
    heard = ping(echo(middle() - 150, num_mics=32), mic_positions_m=np.tile(MICS_M, (4, 1)))
    for one in found:
        seen = paper_features(heard, one)
        assert seen.shape == (one.num_bins,)
        assert np.isfinite(seen).all()
        np.testing.assert_array_equal(seen, paper_features(heard, one.preparation))


def spectra(rng, labels):
    """Each label a bump elsewhere, none a slope; of the size that real spectra have."""
    names = ("r35", "r48", "r58", "r70")
    rows = rng.normal(0, 0.1, (len(labels), 20)) + 1
    for row, label in zip(rows, labels, strict=True):
        if label == NONE:
            row += np.linspace(0, 1.5, 20)
        else:
            row[3 * names.index(label) : 3 * names.index(label) + 3] += 1.0
    return 1e-3 * rows


@pytest.mark.parametrize("stages", ["two", "one"])
@pytest.mark.parametrize("scaling", ["standard", "minmax", "unit"])
def test_it_tells_apart_what_a_line_can(stages, scaling):
    rng = np.random.default_rng(3)
    labels = [str(name) for name in rng.choice(["r70", "r35", "r48", NONE, "r58"], 200)]
    method = PaperMethod(PaperChoices(stages=stages, scaling=scaling, weighting="balanced"))
    method.fit(spectra(rng, labels), labels)
    assert method.classes == ("r35", "r48", "r58", "r70", NONE)
    asked = [str(name) for name in rng.choice(method.classes, 100)]
    told = method.predict(spectra(rng, asked))
    np.testing.assert_allclose(told.sum(axis=1), 1)
    none = np.array(asked) == NONE
    assert np.mean((told[:, -1] > 0.5) == none) > 0.97
    size = np.array(method.classes)[told[:, :-1].argmax(axis=1)]
    assert np.mean((size == asked)[~none]) > 0.97


def test_two_sizes_are_enough_and_one_is_not():
    rng = np.random.default_rng(4)
    labels = ["r35", "r70", NONE] * 20
    method = PaperMethod()
    method.fit(spectra(rng, labels), labels)
    told = method.predict(spectra(rng, labels))
    assert [method.classes[i] for i in told[:, :-1].argmax(axis=1)][:2] == ["r35", "r70"]
    for wrong in (["r35", NONE] * 10, ["r35", "r48"] * 10):
        with pytest.raises(EvaluationError, match="expected two landmarks at least, and none"):
            method.fit(spectra(rng, wrong), wrong)

import numpy as np
import pytest

from ertis_detector.air import Air
from ertis_detector.imaging import (
    Energyscape,
    Focus,
    Imager,
    MatchedFilter,
    noise_floor,
    plane,
    unit_vectors,
)
from ertis_detector.locate import locate
from ertis_detector.proposals import Proposal, propose
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.propagation import render

NUM_SAMPLES, RATE_HZ = 16_384, 450e3
AIR = Air()
C = AIR.speed_of_sound_m_s
CHIRP = DEFAULT_CHIRP.samples(RATE_HZ)
MICS, EMITTER = mic_positions_m(), np.array(EMITTER_POSITION_M)
NOISE = 10 ** (-101 / 20) * np.sqrt(RATE_HZ / 2)


class Bench:
    """Filter, image and focus for one device, and points to listen to."""

    def __init__(self):
        self.filter = MatchedFilter(CHIRP, NUM_SAMPLES, (20e3, 80e3))
        self.imager = Imager(MICS, self.filter.baseband, C, *plane())
        self.focus = Focus(MICS, EMITTER, self.filter.baseband, C)

    def hear(self, places, seed, strength=0.05):
        """Baseband and image of reflectors at (range m, azimuth deg, elevation deg), in noise."""
        parts = []
        for range_m, azimuth_deg, elevation_deg in places:
            angles = np.deg2rad([azimuth_deg, elevation_deg])
            point = range_m * unit_vectors(*angles)
            out, back = np.linalg.norm(point - EMITTER), np.linalg.norm(point - MICS, axis=1)
            parts.append(Echoes.of(out + back, strength / (out * back)))
        if parts:
            clean = np.ones(32, np.complex64)
            audio = render(Echoes.join(parts), AIR, CHIRP, NUM_SAMPLES, clean)
        else:
            audio = np.zeros((32, NUM_SAMPLES), np.float32)
        rng = np.random.default_rng(seed)
        audio += np.float32(NOISE) * rng.standard_normal(audio.shape, dtype=np.float32)
        baseband = self.filter(audio)
        return baseband, self.imager(baseband)


@pytest.fixture(scope="module")
def bench():
    return Bench()


def apart(proposals, places):
    """For each place, whether a proposal lies within 5 cm and 4 degrees of it."""
    return [
        any(
            abs(p.range_m - r) < 0.05 and abs(np.rad2deg(p.azimuth_rad) - a) < 4.0
            for p in proposals
        )
        for r, a, _ in places
    ]


@pytest.mark.parametrize(
    "places",
    [
        [(1.5, 0.0, 0.0), (1.5, 30.0, 0.0)],
        [(1.2, -20.0, 0.0), (2.0, 25.0, 0.0)],
        [(2.0, 10.0, 0.0), (2.3, 10.0, 0.0)],
        [(1.0, -40.0, 0.0), (3.0, 5.0, 0.0)],
    ],
)
def test_two_reflectors_give_two_proposals_and_none_for_their_sidelobes(bench, places):
    _, scape = bench.hear(places, seed=1)
    proposals = propose(scape, max_count=12, min_snr_db=14.0)
    assert apart(proposals, places) == [True, True]
    assert len(proposals) == 2


def test_one_strong_reflector_gives_one_proposal(bench):
    for azimuth_deg, strength in ((-35.0, 0.1), (0.0, 0.1), (20.0, 0.1), (10.0, 5.0)):
        _, scape = bench.hear([(1.5, azimuth_deg, 0.0)], seed=2, strength=strength)
        assert len(propose(scape, max_count=12, min_snr_db=14.0)) == 1


def test_noise_alone_proposes_nothing(bench):
    for seed in range(3):
        _, scape = bench.hear([], seed)
        assert propose(scape, max_count=12, min_snr_db=14.0) == []


def scape_of(power):
    azimuth = np.arcsin(np.linspace(-0.8, 0.8, power.shape[0]))
    range_m = 0.5 + 0.006 * np.arange(power.shape[1])
    return Energyscape(power.astype(np.float32), azimuth, 0 * azimuth, range_m, noise_floor(power))


def quiet(seed=3, shape=(91, 600)):
    return np.random.default_rng(seed).exponential(1.0, shape)


def test_a_proposal_says_where_and_how_far_over_the_floor():
    power = quiet()
    power[30, 200] = 1000.0
    (proposal,) = propose(scape_of(power), max_count=5, min_snr_db=20.0)
    assert proposal.range_m == pytest.approx(0.5 + 0.006 * 200)
    assert np.sin(proposal.azimuth_rad) == pytest.approx(-0.8 + 1.6 * 30 / 90)
    assert proposal.snr_db == pytest.approx(30.0, abs=0.5)


def test_the_floor_is_that_of_the_noise():
    assert scape_of(4.0 * quiet(4)).noise_floor == pytest.approx(4.0, rel=0.05)


def test_a_far_peak_comes_before_a_near_one_of_the_same_strength():
    power = quiet()
    power[20, 50] = power[70, 550] = 1000.0
    near_first = propose(scape_of(power), max_count=5, min_snr_db=20.0)
    assert [round((p.range_m - 0.5) / 0.006) for p in near_first] == [550, 50]


def test_what_must_stand_out_further_at_some_ranges_is_not_proposed_there_if_it_does_not():
    power = quiet()
    power[20, 50] = power[70, 550] = 1000.0
    least_db = np.where(np.arange(600) < 100, 40.0, 20.0)
    (far,) = propose(scape_of(power), max_count=5, min_snr_db=least_db)
    assert round((far.range_m - 0.5) / 0.006) == 550


def test_no_more_are_proposed_than_asked_for():
    power = quiet()
    power[10::20, 50::100] = 1000.0
    found = propose(scape_of(power), max_count=7, min_snr_db=20.0)
    assert len(found) == 7
    assert len({(p.range_m, p.azimuth_rad) for p in found}) == 7


def test_the_image_is_left_as_it_was():
    scape = scape_of(quiet())
    before = scape.power.copy()
    propose(scape, max_count=5, min_snr_db=3.0)
    np.testing.assert_array_equal(scape.power, before)


@pytest.fixture(scope="module")
def located(bench):
    """Errors of seeded points of 25 dB and more: range (m), azimuth, elevation (deg).

    Within 9 degrees of the horizontal: from 12 on, the image shows sidelobes only.
    """
    rng = np.random.default_rng(5)
    errors, levels = [], []
    for number in range(24):
        place = rng.uniform(0.8, 4.0), rng.uniform(-40, 40), rng.uniform(-9, 9)
        baseband, scape = bench.hear([place], 100 + number, strength=0.2)
        proposal = max(
            propose(scape, max_count=3, min_snr_db=14.0),
            key=lambda p: p.snr_db,
        )
        (at,) = locate(bench.focus, baseband, [proposal])
        levels.append(10 * np.log10(at.power / scape.noise_floor))
        found = at.range_m, np.rad2deg(at.azimuth_rad), np.rad2deg(at.elevation_rad)
        errors.append(np.array(found) - place)
        assert np.linalg.norm(point_m(at)) == pytest.approx(at.range_m)
    errors, levels = np.array(errors), np.array(levels)
    loud = levels >= 25.0
    assert loud.sum() >= 16
    return errors[loud]


def test_the_range_is_right_within_4_mm(located):
    assert np.abs(located[:, 0]).max() <= 4e-3


def test_the_azimuth_is_right_within_half_a_degree(located):
    assert np.abs(located[:, 1]).max() <= 0.5


def test_the_elevation_is_right_within_a_degree_and_a_half(located):
    assert np.abs(located[:, 2]).max() <= 1.5


def test_a_proposal_some_degrees_off_is_drawn_in(bench):
    baseband, _ = bench.hear([(1.5, 10.0, 5.0)], seed=6)
    for off_deg in (-2.0, 2.0):
        off = Proposal(1.5, float(np.deg2rad(10.0 + off_deg)), 30.0)
        (at,) = locate(bench.focus, baseband, [off])
        assert np.rad2deg(at.azimuth_rad) == pytest.approx(10.0, abs=0.5)
        assert at.range_m == pytest.approx(1.5, abs=4e-3)


def point_m(at):
    return at.range_m * unit_vectors(np.array(at.azimuth_rad), np.array(at.elevation_rad))


def test_silence_is_located_without_a_fall(bench):
    silence = np.zeros((32, NUM_SAMPLES), np.complex64)
    (at,) = locate(bench.focus, silence, [Proposal(2.0, 0.3, 20.0)])
    assert np.isfinite([at.range_m, at.azimuth_rad, at.elevation_rad]).all()
    assert at.power == 0.0


def test_several_are_located_together_as_each_alone(bench):
    places = [(1.2, -20.0, 5.0), (2.0, 25.0, -10.0)]
    baseband, scape = bench.hear(places, seed=7)
    proposals = propose(scape, max_count=2, min_snr_db=14.0)
    together = locate(bench.focus, baseband, proposals)
    alone = [locate(bench.focus, baseband, [one])[0] for one in proposals]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_allclose(point_m(one), point_m(other), atol=1e-6)
    assert locate(bench.focus, baseband, []) == []

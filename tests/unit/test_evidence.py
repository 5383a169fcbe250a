import math

import numpy as np
import pytest

from ertis_detector.evidence import MAX_VIEWS, NOISE_PART, PERSISTENT_PART, Evidence
from ertis_detector.rates import DetectorRates
from ertis_detector.visibility import FieldOfView, detectable, level_change_db

RATES = DetectorRates(0.02, 0.9, 0.9, 4.0)
LABELS = ("r35", "r48", "r58", "r70", "none", "unknown")
SURE = dict(zip(LABELS, (0.01, 0.94, 0.01, 0.01, 0.02, 0.01), strict=True))
PRIOR = dict(zip(LABELS, (*[0.9 / 4] * 4, 0.05, 0.05), strict=True))
PD = 0.9


def view(side_deg=0.0):
    return np.array([math.radians(side_deg), 2.0, 0.0])


def heard(sides_deg, told=SURE, likely=10.0):
    evidence = Evidence(RATES, LABELS)
    for side in sides_deg:
        evidence.heard(view(side), told, PD, likely)
    return evidence


def test_one_ping_says_what_its_calibrated_probabilities_say():
    evidence = heard([0.0])
    odds = math.log(0.97 / 0.03) - math.log(0.9 / 0.1)
    assert evidence.existence == pytest.approx(odds)
    assert evidence.probabilities() == pytest.approx(SURE)


def test_a_detection_of_average_probabilities_says_nothing():
    evidence = heard([0.0], PRIOR)
    assert evidence.existence == pytest.approx(0.0, abs=1e-9)
    assert evidence.size_share() == pytest.approx(dict.fromkeys(LABELS[:4], 0.25))


def test_the_same_view_again_says_no_more_than_its_own_noise_does():
    once, often = heard([0.0]), heard([0.0] * 500)
    again = math.log(PD / RATES.chance)
    for_r48 = math.log(0.94 / PRIOR["r48"]) - math.log(0.03 / 0.1)
    most = (for_r48 + again) / (1 - NOISE_PART) - again - math.log(4)
    assert once.existence < often.existence < most + 0.02  # the other sizes' share


def test_more_different_views_say_more_and_never_more_than_independent_ones():
    totals = [heard(np.arange(4) * step).existence for step in (0.0, 0.5, 2.0, 8.0)]
    assert totals == sorted(totals)
    once, again = heard([0.0]).existence, math.log(PD / RATES.chance)
    assert totals[-1] < 4 * (once + again) - again


def test_what_misleads_from_everywhere_is_never_proof():
    everywhere = heard(np.arange(1000) * 10.0)
    per_ping = heard([0.0]).existence + math.log(PD / RATES.chance)
    assert everywhere.existence < per_ping / ((1 - NOISE_PART) * PERSISTENT_PART)


def test_sizes_add_up_over_views():
    torn = dict(zip(LABELS, (0.01, 0.5, 0.45, 0.02, 0.01, 0.01), strict=True))
    one, many = heard([0.0], torn).size_share(), heard([0.0, 8.0, 16.0], torn).size_share()
    assert many["r48"] > one["r48"] > 0.5


def test_silence_speaks_against_it_and_more_where_it_would_be_heard():
    evidence = {}
    for reported in (0.3, 0.9):
        evidence[reported] = heard([0.0])
        for side in (5.0, 10.0, 15.0):
            evidence[reported].missed(view(side), reported)
    assert evidence[0.9].existence < evidence[0.3].existence < heard([0.0]).existence


def test_silence_where_it_was_heard_counts_in_full_against_chance_alarms():
    sides = [0.0, 8.0, 16.0]
    heard_only, evidence = heard(sides, likely=0.0), heard(sides, likely=0.0)
    evidence.missed(view(), PD)
    fall = heard_only.existence - evidence.existence
    assert fall == pytest.approx(-math.log(1 - PD))


def test_what_was_heard_or_missed_for_long_is_given_up_or_believed_again_in_time():
    evidence = heard([0.0] * 500, PRIOR)
    for _ in range(25):
        evidence.missed(view(), PD)
    assert evidence.existence < -9.0
    for _ in range(475):
        evidence.missed(view(), PD)
    for _ in range(4):
        evidence.heard(view(), PRIOR, PD, 2.0)
    assert evidence.existence > -5.0


def test_chance_neighbours_are_no_landmark():
    near, far = heard([0.0, 8.0], likely=6.0), heard([0.0, 8.0], likely=-6.0)
    assert far.existence < near.existence - 3.0


def test_views_are_bounded_and_no_evidence_is_forgotten():
    evidence = heard(np.arange(MAX_VIEWS) * 10.0)
    before = evidence.existence
    against = dict(zip(LABELS, (0.1, 0.1, 0.05, 0.05, 0.5, 0.2), strict=True))
    for n in range(200):
        evidence.heard(view(100.0 + n), against, PD, 10.0)
    assert evidence._num_views == MAX_VIEWS
    assert evidence._counts.sum() == MAX_VIEWS + 200
    assert evidence.existence < before


def test_a_probability_of_zero_is_no_certainty():
    evidence = heard([0.0], {"r48": 1.0})
    assert math.isfinite(evidence.existence)
    assert evidence.probabilities()["r48"] < 1.0


def test_a_likelihood_ratio_of_clutter_rarely_grows():
    """Ville: it passes A with probability 1 / A at most; here with features that are Gaussian."""
    rng, apart, passed = np.random.default_rng(4), 2.0, 0
    rates = DetectorRates(2.0, 0.5, 0.5, 2.0)  # everything is reported: repetition says nothing
    for _ in range(1500):
        evidence, features = Evidence(rates, ("r48", "none")), rng.normal(size=(5, 2))
        stays = rng.normal()
        best = -math.inf
        for n, (slow, noise) in enumerate(features):
            steady = math.sqrt(PERSISTENT_PART) * stays + math.sqrt(1 - PERSISTENT_PART) * slow
            x = math.sqrt(1 - NOISE_PART) * steady + math.sqrt(NOISE_PART) * noise
            p = 1 / (1 + math.exp(-apart * (x - apart / 2)))
            evidence.heard(view(40.0 * n), {"r48": p, "none": 1 - p}, rates.chance, 10.0)
            best = max(best, evidence.existence)
        passed += best > math.log(10.0)
    assert 0 < passed / 1500 < 0.1 + 3 * math.sqrt(0.09 / 1500)


def test_figures_of_a_card_become_rates():
    figures = {
        "false_alarms_per_ping": 0.1,
        "precision": 0.75,
        "found": 0.5,
        "landmark_proposals": 1200.0,
        "proposals": 9200.0,
    }
    rates = DetectorRates.from_figures(figures)
    assert (rates.false_alarms_per_ping, rates.precision, rates.found) == (0.1, 0.75, 0.5)
    # 600 found are three quarters of 800 reports; 200 false at 0.1 a ping are 2000 pings.
    assert rates.clutter_per_ping == pytest.approx(4.0)
    assert rates.chance == pytest.approx(0.025)


@pytest.mark.parametrize("nonsense", [{}, {"found": math.nan, "precision": 7.0, "proposals": "x"}])
def test_a_card_without_sensible_figures_gets_cautious_ones(nonsense):
    assert DetectorRates.from_figures(nonsense) == DetectorRates()


def test_no_false_alarm_in_the_evaluation_is_not_taken_for_none_ever():
    assert DetectorRates.from_figures({"false_alarms_per_ping": 0.0}).false_alarms_per_ping > 0.0
    silent = DetectorRates.from_figures({"found": 0.0, "precision": 0.0})
    assert 0.0 < silent.chance < silent.found
    for precision in (0.0, 1.0):  # of few reports
        assert 0.0 < DetectorRates.from_figures({"precision": precision}).precision < 1.0


def test_a_nearer_and_less_oblique_echo_is_louder():
    here = np.array([2.0, 0.2, 0.0])
    assert level_change_db(here, here) == pytest.approx(0.0)
    assert level_change_db(here, np.array([1.0, 0.2, 0.0])) == pytest.approx(12.04 + 3.32, abs=0.01)
    assert level_change_db(here, np.array([2.0, 0.0, 0.0])) > 2.0


def test_a_faint_echo_is_missed_and_none_is_certain():
    probabilities = [detectable(RATES, level) for level in (-300.0, 5.0, 14.0, 40.0, 300.0)]
    assert probabilities == sorted(probabilities)
    assert probabilities[2] == pytest.approx(0.45)
    assert 0.0 < probabilities[0] < probabilities[-1] <= RATES.found


def test_the_field_of_view_ends_before_its_edge():
    field = FieldOfView()
    assert field.holds(np.array([2.0, 0.0, 0.0]))
    for outside in ((0.65, 0.0, 0.0), (4.55, 0.0, 0.0), (2.0, 0.51, 0.0), (2.0, 0.0, -0.2)):
        assert not field.holds(np.array(outside))

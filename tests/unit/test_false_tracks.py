"""Drives without a landmark, and how much evidence a false event takes for that."""

import math

import numpy as np
import pytest
from test_tracker import GOOD, PERIOD_NS, seen, weak

from ertis_detector.drives import peaks
from ertis_detector.errors import DetectorError
from ertis_detector.false_tracks import LEAST_TRACKS, FalseTracks
from ertis_detector.rates import DetectorRates
from ertis_detector.tracker import Tracker, TrackerSettings


def drawn(count, fade, seed=1):
    return np.random.default_rng(seed).exponential(1 / fade, count) - 2.0


def test_the_law_is_found_that_the_peaks_were_drawn_from():
    law = FalseTracks.of(drawn(4000, 0.6).tolist(), 1_000_000)
    assert law.fade == pytest.approx(0.6, rel=0.07)
    # Of 4000 tracks exp(-0.6 (t + 2)) pass t.
    for level in (1.0, 4.0, 7.0):
        rate = 4e-3 * math.exp(-0.6 * (level + 2.0))
        assert law.level(rate) == pytest.approx(level, abs=0.8)


def test_a_few_lowest_peaks_do_not_change_what_the_highest_tell():
    high = drawn(200, 0.6).tolist()
    law = FalseTracks.of([*high, *[-9.0] * 3], 10_000)
    assert law.level(1e-4) == pytest.approx(FalseTracks.of(high, 10_000).level(1e-4), abs=0.3)


def test_evidence_is_never_believed_to_be_better_than_exact():
    law = FalseTracks.of([-1.0] * 100, 1000)
    assert law == FalseTracks(pytest.approx(0.02 * math.exp(-1.0)), 1.0)


def test_too_short_a_drive_says_nothing():
    with pytest.raises(DetectorError, match=r"39 things .* 500 pings .* drive for longer"):
        FalseTracks.of([0.0] * (LEAST_TRACKS - 1), 500)


def test_it_goes_through_a_model_card_and_nonsense_there_counts_for_nothing():
    law = FalseTracks(0.004, 0.61)
    assert FalseTracks.from_figures(law.figures()) == law
    assert DetectorRates.from_figures(law.figures()).false_tracks == law
    for nonsense in ({}, {"false_tracks_per_ping": 0.1}, {**law.figures(), "false_tracks_fade": 0}):
        assert FalseTracks.from_figures(nonsense) is None
    assert FalseTracks.from_figures({**law.figures(), "false_tracks_fade": "much"}) is None


def test_where_somebody_drove_a_landmark_is_announced_at_the_level_that_was_passed_so_seldom():
    law = FalseTracks(0.01, 0.5)
    settings = TrackerSettings(max_false_events_per_hour=10.0, ping_rate_hz=10.0)
    level = settings.least_existence(DetectorRates(false_tracks=law))
    passed_an_hour = law.per_ping * math.exp(-law.fade * level) * 36_000
    assert passed_an_hour == pytest.approx(0.8 * 10.0)
    often = TrackerSettings(max_false_events_per_hour=1e6, ping_rate_hz=10.0)
    assert often.least_existence(DetectorRates(false_tracks=law)) == 0.0


def test_peaks_are_the_most_that_each_thing_was_ever_believed():
    """One thing that is believed less and less, and one that is heard once."""
    drive = [([seen(1.5, p=p)], n * PERIOD_NS, None) for n, p in enumerate((0.95, 0.6, 0.6, 0.6))]
    drive[1][0].append(seen(3.0, 20.0, p=0.7))
    found = peaks(drive, Tracker(GOOD))
    assert len(found) == 2
    alone = [peaks([(told, 0, None)], Tracker(GOOD))[0] for told in ([seen(p=0.95)], [seen(p=0.7)])]
    assert found == pytest.approx(alone)


def test_what_starts_no_track_is_no_false_track():
    assert peaks([([weak()], 0, None)], Tracker(GOOD)) == []

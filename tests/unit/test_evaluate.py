"""Judging a detector that is not told the range."""

import math

import numpy as np
import pytest

from ertis_detector.accuracy import nees_band, place_errors
from ertis_detector.calibration import recalibrated, reliability
from ertis_detector.detection import Detection
from ertis_detector.errors import EvaluationError
from ertis_detector.evaluate import evaluate
from ertis_detector.matching import JudgedPing, TrueLandmark, match

SIGMAS = (4e-3, 0.01, 0.03)
NAMES = ("r35", "r48", "r58", "r70")


def told(label="r48", range_m=2.0, azimuth=0.1, elevation=0.0, p=0.8, tilt=math.nan):
    rest = {name: 0.25 * (0.95 - p) for name in (*NAMES, "unknown") if name != label}
    probabilities = {**rest, label: p, "none": 0.05}
    covariance = tuple(tuple(SIGMAS[i] ** 2 if i == j else 0.0 for j in range(3)) for i in range(3))
    return Detection(label, probabilities, range_m, azimuth, elevation, covariance, 20.0, tilt)


def weak(label="r48", landmark=0.3, **where):
    """A report that is a landmark with that probability, in all."""
    one = told(label, **where)
    probabilities = dict.fromkeys(NAMES, 0.0) | {label: landmark, "none": 1 - landmark}
    return Detection(
        label,
        probabilities,
        one.range_m,
        one.azimuth_rad,
        one.elevation_rad,
        one.covariance,
        one.snr_db,
    )


def true(label="r48", range_m=2.0, azimuth=0.1, **more):
    fields = {"elevation_rad": 0.0, "tilt_rad": 0.1, "own_to_rest_db": 5.0} | more
    return TrueLandmark(label, range_m, azimuth, **fields)


def ping(landmarks=(), detections=(), group="a", seconds=0.01):
    return JudgedPing(tuple(landmarks), tuple(detections), seconds, group)


def test_a_report_belongs_to_the_nearest_landmark_inside_the_gates():
    landmarks = [true(range_m=2.0), true(range_m=2.1), true(range_m=3.0)]
    reports = [told(range_m=2.08), told(range_m=2.01), told(range_m=3.16), told(azimuth=0.3)]
    pairs = match(landmarks, reports)
    assert pairs.found == {0: 1, 1: 0}
    assert pairs.false == (2, 3)


def test_each_report_is_used_once_and_hidden_landmarks_take_what_is_left():
    hidden, seen = true(visible=False), true(range_m=2.05)
    pairs = match([hidden, seen], [told(range_m=2.0)])
    assert (pairs.found, pairs.beyond, pairs.false) == ({1: 0}, {}, ())
    pairs = match([hidden, seen], [told(range_m=2.0), told(range_m=2.06)])
    assert (pairs.found, pairs.beyond, pairs.false) == ({1: 1}, {0: 0}, ())


def test_where_nobody_knows_the_elevation_only_azimuth_is_held_to():
    unknown = true(elevation_rad=math.nan)
    assert match([unknown], [told(elevation=0.5)]).found == {0: 0}
    assert match([true()], [told(elevation=0.5)]).found == {}
    assert match([true()], [told(range_m=math.nan)]).false == (0,)


def test_located_right_size_false_and_missed_are_counted_apart():
    judged = evaluate(
        [
            ping([true("r48")], [told("r48")], "a"),
            ping([true("r48")], [told("r58")], "a"),
            ping([true("r35", 1.0)], [told("r35", 2.0)], "b"),
            ping([true("r35", visible=False)], [told("r35")], "b"),
            ping([], [told(), told(range_m=4.0)], "c"),
            ping([], [weak(landmark=0.3)], "c"),
        ],
        threshold=0.6,
        rate_hz=6.0,
    )
    heard = judged.conditions["can be heard"]
    assert (heard.located.successes, heard.right_size.successes, heard.located.trials) == (2, 1, 3)
    beyond = judged.conditions["beyond what is asked (turned, hidden, aside)"]
    assert (beyond.located.successes, beyond.located.trials) == (1, 1)
    alarms = judged.false_alarms
    assert (alarms.free_pings, alarms.on_free, alarms.elsewhere) == (2, 2, 1)
    assert alarms.per_minute == pytest.approx(2 / 2 * 360)
    assert alarms.interval[0] < 360 < alarms.interval[1]
    assert judged.sizes == ("r48", "r58")
    np.testing.assert_array_equal(judged.size_confusion, [[1, 1], [0, 0]])
    assert judged.num_groups == 3


def test_the_targets_condition_leaves_out_turned_oblique_and_buried_dishes():
    asked = [
        true(),
        true(tilt_rad=np.deg2rad(26)),
        true(azimuth=np.deg2rad(-21)),
        true(own_to_rest_db=-0.1),
        true(own_to_rest_db=math.nan),
        true(visible=False),
    ]
    judged = evaluate([ping([one]) for one in asked], 0.5)
    name = "tilt < 25, |azimuth| < 20 degrees, signal-to-clutter >= 0 dB"
    assert judged.conditions[name].located.trials == 1
    assert judged.conditions["can be heard"].located.trials == 5


def test_the_curve_holds_the_threshold_used_and_falls_with_it():
    pings = [
        ping([true()], [weak(landmark=p)], group)
        for p, group in ((0.9, "a"), (0.7, "b"), (0.4, "c"))
    ]
    pings.append(ping([], [weak(landmark=0.6)], "d"))
    judged = evaluate(pings, 0.62)
    used = next(one for one in judged.curve if one.threshold == 0.62)
    assert used.located == pytest.approx(2 / 3)
    assert (used.precision, used.false_per_free_ping) == (1.0, 0.0)
    at_half = max((one for one in judged.curve if one.threshold <= 0.55), key=lambda p: p.threshold)
    assert at_half.precision == pytest.approx(2 / 3)
    assert at_half.false_per_free_ping == 1.0
    located = [one.located for one in judged.curve]
    assert located == sorted(located, reverse=True)


def test_what_was_found_is_told_over_range_azimuth_tilt_and_clutter():
    near, far = true(range_m=1.2), true(range_m=3.2, own_to_rest_db=-7.0)
    judged = evaluate([ping([near], [told(range_m=1.2)]), ping([far])], 0.5)
    bins = {(low, high): one for low, high, one in judged.over["range (m)"]}
    assert bins[(1.0, 1.5)].located.share == 1.0
    assert bins[(3.0, 3.5)].located.share == 0.0
    clutter = [(low, one.located.share) for low, _, one in judged.over["signal-to-clutter (dB)"]]
    assert clutter == [(-10.0, 0.0), (5.0, 1.0)]
    assert set(judged.over) == {
        "range (m)",
        "|azimuth| (degrees)",
        "tilt (degrees)",
        "signal-to-clutter (dB)",
    }


def test_without_landmark_free_pings_no_rate_of_false_alarms_is_told():
    judged = evaluate([ping([true()])], 0.5)
    assert math.isnan(judged.false_alarms.per_minute)
    with pytest.raises(EvaluationError, match="no pings to judge"):
        evaluate([], 0.5)


def test_true_probabilities_have_no_calibration_error_and_boasts_have():
    rng = np.random.default_rng(1)
    said = rng.uniform(0, 1, 20_000)
    groups = [str(i % 40) for i in range(said.size)]
    honest = reliability(said, rng.random(said.size) < said, groups)
    assert honest.expected_error < 0.02
    boast = reliability(said, rng.random(said.size) < said**2, groups)
    assert boast.expected_error == pytest.approx(1 / 6, abs=0.01)  # mean of p - p^2
    assert boast.interval[0] < boast.expected_error < boast.interval[1]
    assert sum(one.count for one in boast.bins) == said.size
    assert math.isnan(reliability(np.empty(0), np.empty(0, bool), []).expected_error)


def test_what_other_environments_teach_mends_a_boast_and_leaves_what_is_true():
    rng = np.random.default_rng(2)
    true_p = rng.uniform(0.02, 0.98, 6000)
    came = rng.random(true_p.size) < true_p
    places = [str(i % 5) for i in range(true_p.size)]
    odds = np.log(true_p / (1 - true_p))
    boast = 1 / (1 + np.exp(-2 * odds - 1))
    assert reliability(boast, came, places).expected_error > 0.1
    assert reliability(recalibrated(boast, came, places), came, places).expected_error < 0.03
    np.testing.assert_allclose(recalibrated(true_p, came, places), true_p, atol=0.04)


def test_an_environment_teaches_nothing_about_itself():
    told, places = np.full(200, 0.7), ["a"] * 100 + ["b"] * 100
    came = np.array([True] * 100 + [False] * 100)
    better = recalibrated(told, came, places)
    assert better[:100].max() < 0.05, "b says that it never comes true"
    assert better[100:].min() > 0.95


def test_environments_are_left_out_only_where_there_are_two():
    pings = [JudgedPing((true(),), (told(),), 0.01, "a", place) for place in ("lab", "hall")]
    assert evaluate(pings, 0.5).recalibrated is not None
    assert evaluate(pings[:1], 0.5).recalibrated is None
    assert evaluate([ping([true()], [told()])], 0.5).recalibrated is None


def test_a_reports_probability_is_right_only_with_place_and_size():
    pings = [ping([true("r48")], [told("r48"), told("r48", range_m=4.0)])]
    pings += [ping([true("r58")], [told("r48")])]
    (only,) = evaluate(pings, 0.5).reliability.bins
    assert (only.count, only.came_true) == (3, pytest.approx(1 / 3))
    assert only.told == pytest.approx(0.8)


def drawn(count, scale, seed=1, **more):
    rng = np.random.default_rng(seed)
    off = rng.normal(0, 1, (count, 3)) * np.array(SIGMAS) * scale
    return [(true(**more), told(range_m=2 + r, azimuth=0.1 + a, elevation=e)) for r, a, e in off]


def test_a_true_covariance_lies_inside_its_band_and_a_proud_one_beyond():
    honest = place_errors(drawn(400, 1.0))
    assert honest.nees_dimensions == 3
    assert honest.nees_band[0] < honest.nees < honest.nees_band[1]
    assert honest.nees_by_axis == pytest.approx((1, 1, 1), abs=0.25)
    assert honest.rms == pytest.approx(SIGMAS, rel=0.15)
    assert honest.sigmas == pytest.approx(SIGMAS)
    proud = place_errors(drawn(400, 1.5))
    assert proud.nees > proud.nees_band[1]
    assert nees_band(400, 3)[0] < 3 < nees_band(400, 3)[1]


def test_each_sizes_mean_range_error_is_told_and_taken_out():
    pairs = [(true(), told("r48", range_m=2.01 + off)) for off in (-0.001, 0.001)] + [
        (true("r70"), told("r70", range_m=1.98 + off)) for off in (-0.001, 0.001)
    ]
    errors = place_errors(pairs)
    assert errors.range_bias_by_size_m == pytest.approx({"r48": 0.01, "r70": -0.02})
    assert errors.range_sigma_m == pytest.approx(math.sqrt(4e-6 / 2))


def test_tilt_counts_where_it_is_told_and_elevation_where_it_is_known():
    pairs = [(true(tilt_rad=0.2), told(tilt=0.3)), (true(tilt_rad=0.2), told())]
    errors = place_errors(pairs)
    assert (errors.tilts, errors.tilt_rmse_rad) == (1, pytest.approx(0.1))
    flat = place_errors(drawn(50, 1.0, elevation_rad=math.nan))
    assert flat.nees_dimensions == 2
    assert math.isnan(flat.rms[2])
    nothing = place_errors([])
    assert nothing.count == 0
    assert math.isnan(nothing.nees)

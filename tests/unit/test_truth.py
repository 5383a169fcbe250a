import json
import math

import pytest

from ertis_daemon.truth import TruthError, bearing_error_rad, compare, read_jsonl, summary


def place(label="r48", range_m=1.0, azimuth_deg=0.0, visible=True):
    return {
        "label": label,
        "range_m": range_m,
        "azimuth_rad": math.radians(azimuth_deg),
        "elevation_rad": 0.0,
        "visible": visible,
    }


def report(label="r48", range_m=1.0, azimuth_deg=0.0, state="update"):
    made = place(label, range_m, azimuth_deg)
    return {**made, "class": label, "state": state}


def score(reports, places):
    events = [{"ping_index": 5, "landmarks": reports}] if reports else []
    return compare(events, [{"ping_index": 5, "landmarks": places}])


def test_a_perfect_report_scores_one():
    result = score([report()], [place()])
    assert (result.present, result.located, result.right_class, result.false) == (1, 1, 1, 0)
    assert (result.range_rms_m, result.bearing_rms_rad) == (0.0, 0.0)


def test_a_wrong_size_is_located_only():
    result = score([report("r70")], [place()])
    assert (result.located, result.right_class, result.false) == (1, 0, 0)


@pytest.mark.parametrize(("range_m", "azimuth_deg"), [(1.16, 0), (0.84, 0), (1, 6.1), (1, -6.1)])
def test_beyond_15_cm_or_6_degrees_it_is_false_and_missed(range_m, azimuth_deg):
    result = score([report(range_m=range_m, azimuth_deg=azimuth_deg)], [place()])
    assert (result.present, result.located, result.false) == (1, 0, 1)


def test_errors_are_root_mean_squares():
    reports = [report(range_m=1.1), report(range_m=2.0, azimuth_deg=3.0)]
    result = score(reports, [place(), place(range_m=2.0)])
    assert result.range_rms_m == pytest.approx(0.1 / math.sqrt(2))
    assert result.bearing_rms_rad == pytest.approx(math.radians(3) / math.sqrt(2))


def test_each_place_and_each_report_counts_once_nearest_first():
    result = score([report("r35", range_m=1.1), report(range_m=1.01)], [place()])
    assert (result.located, result.right_class, result.false) == (1, 1, 1)
    result = score([report()], [place(), place(range_m=1.05)])
    assert (result.present, result.located, result.false) == (2, 1, 0)


def test_a_hidden_landmark_is_neither_missed_nor_false():
    assert score([], [place(visible=False)]).present == 0
    result = score([report()], [place(visible=False)])
    assert (result.present, result.located, result.false) == (0, 0, 0)


def test_a_new_track_is_announced_rightly_on_a_landmark_of_its_size_hidden_or_not():
    new = [report(state="new"), report("r70", range_m=2.0, state="new"), report(azimuth_deg=9.0)]
    hidden = place("r70", range_m=2.0, visible=False)
    result = score(new, [place(), hidden])
    assert (result.announced, result.announced_right) == (2, 2)
    result = score([report("r35", state="new")], [place()])
    assert (result.announced, result.announced_right) == (1, 0)


def test_a_lost_track_claims_nothing():
    result = score([report(state="lost")], [])
    assert (result.located, result.false) == (0, 0)


def test_pings_are_compared_by_index_and_unknown_ones_left_out():
    events = [{"ping_index": 9, "landmarks": [report()]}]
    result = compare(events, [{"ping_index": 5, "landmarks": [place()]}])
    assert (result.pings, result.present, result.located, result.false) == (1, 1, 0, 0)


def test_bearings_near_the_back_and_overhead_are_measured_on_the_sphere():
    back = {"azimuth_rad": math.pi - 0.01, "elevation_rad": 0.0}
    other = {"azimuth_rad": -math.pi + 0.01, "elevation_rad": 0.0}
    assert bearing_error_rad(back, other) == pytest.approx(0.02)
    up = {"azimuth_rad": 0.0, "elevation_rad": math.pi / 2}
    assert bearing_error_rad(up, {**up, "azimuth_rad": 2.0}) == pytest.approx(0.0, abs=1e-9)


def test_a_cut_last_line_is_left_out_and_a_bad_one_named(tmp_path):
    path = tmp_path / "t.jsonl"
    path.write_text(json.dumps({"a": 1}) + '\n\n{"a": ')
    assert read_jsonl(path) == [{"a": 1}]
    path.write_text("{}\nnonsense\n")
    with pytest.raises(TruthError, match=r"t\.jsonl:2: not JSON"):
        read_jsonl(path)
    with pytest.raises(TruthError, match="none"):
        read_jsonl(tmp_path / "none")


def test_a_line_without_its_fields_is_a_truth_error():
    with pytest.raises(TruthError, match="visible"):
        compare([], [{"ping_index": 1, "landmarks": [{}]}])


def test_an_angle_of_no_size_is_a_truth_error():
    endless = place() | {"azimuth_rad": float("inf")}
    with pytest.raises(TruthError, match="garbles"):
        score([report()], [endless])


def test_the_summary_says_that_it_is_simulated():
    text = summary(score([report(range_m=1.1)], [place()]))
    assert text.startswith("0 announced, 0 of them rightly; followed with the right size in 1 of")
    assert "(all simulated)" in text
    assert "100.0 mm in range" in text
    assert "no landmark was present in 1 simulated pings" in summary(score([], []))

import numpy as np
import pytest

from ertis_detector.labelling import match_candidates
from ertis_detector.locate import Location
from ertis_detector.readout import RING_OFFSET
from ertis_detector.scanner import Candidate

DISH = {
    "label": "r48",
    "radius_m": 0.048,
    "range_m": 2.0,
    "azimuth_rad": 0.1,
    "elevation_rad": 0.02,
    "tilt_rad": 0.2,
    "shadowed": False,
}
BOWL = {**DISH, "label": "bowl", "range_m": 3.0}
RING_M = RING_OFFSET * 0.048


def candidate(range_m=2.0 + RING_M, azimuth_rad=0.1, elevation_rad=0.02):
    return Candidate(Location(range_m, azimuth_rad, elevation_rad, 1.0), 30.0)


def label_of(one, **changes):
    truth = {"landmarks": [{**DISH, **changes}], "decoys": [BOWL]}
    [(label, item)] = match_candidates([one], truth)
    return label, item


def test_an_echo_from_where_its_ring_must_be_is_the_landmark():
    label, item = label_of(candidate())
    assert label == "r48"
    assert item["range_m"] == 2.0


@pytest.mark.parametrize(
    "changes",
    [
        {"range_m": 2.0 + RING_M + 0.07},
        {"azimuth_rad": 0.1 + np.deg2rad(6)},
        {"elevation_rad": 0.02 + np.deg2rad(14)},
    ],
)
def test_an_echo_beside_a_landmark_teaches_nothing(changes):
    assert label_of(candidate(**changes)) == (None, None)


def test_a_dish_turned_too_far_or_hidden_teaches_nothing_but_is_known():
    assert label_of(candidate(), tilt_rad=0.8)[0] is None
    assert label_of(candidate(), shadowed=True)[0] is None
    assert label_of(candidate(), tilt_rad=0.8)[1]["label"] == "r48"


def test_a_decoy_is_unknown():
    assert label_of(candidate(3.0 + RING_M))[0] == "unknown"


def test_anything_else_is_none():
    assert label_of(candidate(2.6))[0] == "none"


def test_a_person_who_notes_no_turn_labels_all_the_same():
    truth = {"landmarks": [{k: v for k, v in DISH.items() if k not in ("tilt_rad", "shadowed")}]}
    assert match_candidates([candidate()], truth)[0][0] == "r48"


def test_of_two_dishes_the_nearer_in_range_is_meant():
    other = {**DISH, "label": "r70", "radius_m": 0.070, "range_m": 1.97}
    truth = {"landmarks": [other, DISH]}
    assert match_candidates([candidate()], truth)[0][0] == "r48"

import math

from ros2_rig import landmark_event, report

from ertis_daemon.ros2.docking import STALE_NS, DockChooser

SECOND_NS = 1_000_000_000


def sure(track_id, probability=0.95, **changes):
    return report(track_id, probabilities={"r48": probability, "none": 0.0}, **changes)


def choose(chooser, *reports, at_ns=10 * SECOND_NS, late_ns=0):
    event = landmark_event(*reports, time_ns=at_ns)
    dock = chooser.choose(event, at_ns + late_ns)
    return None if dock is None else dock.track_id


def test_the_most_probable_of_its_class_is_the_dock_and_the_nearer_of_two():
    assert choose(DockChooser("r48", 0.9), sure(1, 0.92), sure(2, 0.97)) == 2
    assert choose(DockChooser("r48", 0.9), sure(1, range_m=3.0), sure(2, range_m=1.0)) == 2


def test_other_classes_doubtful_ones_lost_ones_and_those_without_a_place_are_no_dock():
    chooser = DockChooser("r48", 0.9)
    assert choose(chooser, report(1, label="r58")) is None
    assert choose(chooser, sure(1, 0.89)) is None
    assert choose(chooser, sure(1, state="lost")) is None
    assert choose(chooser, sure(1, range_m=math.nan)) is None
    assert choose(chooser, sure(1, azimuth_rad=math.nan)) is None


def test_the_dock_stays_the_dock_while_it_is_heard():
    chooser = DockChooser("r48", 0.9)
    assert choose(chooser, sure(1)) == 1
    later_ns = 10 * SECOND_NS + STALE_NS // 2
    assert choose(chooser, sure(1, 0.91), sure(2, 0.99), at_ns=later_ns) == 1
    assert choose(chooser, sure(2, 0.99), at_ns=later_ns) is None, "no jump within a second"


def test_another_takes_its_place_after_a_second_of_silence_or_when_it_is_lost():
    silent, lost = DockChooser("r48", 0.9), DockChooser("r48", 0.9)
    assert choose(silent, sure(1)) == choose(lost, sure(1)) == 1
    assert choose(silent, sure(2), at_ns=11 * SECOND_NS + 1) == 2
    assert choose(lost, sure(1, state="lost"), sure(2), at_ns=10 * SECOND_NS + 1) == 2


def test_an_event_older_than_a_second_tells_of_no_dock():
    chooser = DockChooser("r48", 0.9)
    assert choose(chooser, sure(1), late_ns=STALE_NS) == 1
    assert choose(chooser, sure(1), late_ns=STALE_NS + 1) is None

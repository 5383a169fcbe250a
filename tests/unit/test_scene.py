"""What a scene sounds like as a whole: motion, shadow, noise, air, dead microphones."""

import dataclasses

import numpy as np
import pytest
import scipy.signal

from ertis_detector.air import Air
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.geometry import mic_positions_m
from ertis_simulator.clutter import Clutter
from ertis_simulator.landmark import Dish
from ertis_simulator.noise_sources import MARGIN, AirGun, OtherSonar, Tone, add_sources
from ertis_simulator.objects import draw_sizes, make_thing
from ertis_simulator.path import Path
from ertis_simulator.propagation import render
from ertis_simulator.room import Room
from ertis_simulator.scene import DishObject, Pose, Scene

CHIRP = DEFAULT_CHIRP.samples(450e3)
NUM_WORDS = 81_920
OPEN = Room((-np.inf, np.inf), (-np.inf, np.inf), floor_reflection=0.0)
START = Pose((0.0, 0.0, 0.6), 0.0)


def landmark(x_m=2.0, y_m=0.0, **changes):
    at = (x_m, y_m, 0.6)
    return DishObject("r58", Dish.landmark(58), at, (np.pi + np.arctan2(y_m, x_m), 0.0), **changes)


def box(x_m=1.2, y_m=0.0, **sizes):
    full = {"width_m": 0.5, "depth_m": 0.1, "base_m": 0.0, "top_m": 1.5, **sizes}
    rng = np.random.default_rng(0)
    return make_thing("box", x_m, y_m, np.pi, draw_sizes("box", full, rng), rng)


def scene(*dishes, **changes):
    return Scene(OPEN, START, dishes, seed=1, **changes)


def own_sound(made, ping_index=0):
    """The first dish's direct echo alone, shape (32, 9000)."""
    part = made.own_echoes(made.dishes[0], ping_index)
    return render(part, made.air, CHIRP, 9_000, np.ones(32, np.complex64)).astype(float)


def own_level_db(made):
    if made.own_echoes(made.dishes[0], 0) is None:
        return -np.inf
    return 10 * np.log10(np.sum(own_sound(made) ** 2))


def told(made, ping_index=0):
    return made.truth(ping_index)["landmarks"][0]


def test_a_landmark_behind_a_box_is_shadowed_in_truth_and_silent():
    free, hidden = scene(landmark()), scene(landmark(), things=(box(),))
    assert (told(free)["shadowed"], told(free)["visible"]) == (False, True)
    assert (told(hidden)["shadowed"], told(hidden)["visible"]) == (True, False)
    assert own_level_db(hidden) < own_level_db(free) - 60


def test_a_landmark_half_hidden_is_heard_by_half():
    half = scene(landmark(), things=(box(y_m=0.25),))
    assert told(half)["clear_part"] == pytest.approx(0.5, abs=0.2)
    drop_db = own_level_db(scene(landmark())) - own_level_db(half)
    assert drop_db == pytest.approx(-20 * np.log10(told(half)["clear_part"]), abs=0.1)


def test_a_box_that_walks_by_hides_the_landmark_for_a_while():
    path = Path((0.0, 1.0), ((1.2, -1.0), (1.2, 1.0)), (0.0, 0.0))
    walker = dataclasses.replace(box(y_m=-1.0), path=path)
    made = scene(landmark(), things=(walker,), ping_period_s=0.1)
    shadowed = [told(made, index)["shadowed"] for index in range(11)]
    assert shadowed == [False] * 4 + [True] * 3 + [False] * 4
    place = [made.truth(index)["objects"][0]["azimuth_rad"] for index in range(11)]
    assert place == sorted(place)


def test_a_landmark_in_front_hides_the_one_behind_it_and_not_the_other_way_round():
    made = scene(landmark(1.0), landmark(2.0))
    assert [item["shadowed"] for item in made.truth(0)["landmarks"]] == [False, True]


def test_a_landmark_that_the_sonar_stands_in_is_not_visible_and_has_a_tilt():
    there = told(scene(landmark(0.0)))
    assert (there["range_m"], there["visible"]) == (0.0, False)
    assert np.isfinite(there["tilt_rad"])


def test_a_landmark_carried_away_is_told_where_it_is():
    path = Path((0.0, 2.0), ((2.0, 0.0), (3.0, 0.0)), (0.0, 0.0))
    made = scene(landmark(path=path), ping_period_s=1.0)
    assert [told(made, index)["range_m"] for index in (0, 1, 2, 3)] == [2.0, 2.5, 3.0, 3.0]
    heard = [own_sound(made, index)[9] for index in (0, 1)]
    lag = np.argmax(scipy.signal.correlate(heard[1], heard[0])) - (len(heard[0]) - 1)
    assert lag / 450e3 * made.air.speed_of_sound_m_s == pytest.approx(1.0, abs=0.02)


def test_the_sonar_follows_its_path():
    path = Path((0.0, 1.0), ((0.0, 0.0), (1.0, 0.5)), (0.0, 0.2))
    made = scene(landmark(), path=path, ping_period_s=0.5)
    assert made.pose(1) == Pose((0.5, 0.25, 0.6), 0.1)
    assert told(made, 2)["range_m"] == pytest.approx(np.hypot(1.0, 0.5), abs=1e-4)


def test_a_sonar_that_rolls_on_for_long_turns_back_before_the_walls():
    hall = Room((-1.0, 2.3), (-np.inf, np.inf))
    moving = Scene(hall, START, velocity_m_s=(1.0, 0.1), ping_period_s=0.5)
    along = [moving.pose(n).position_m[0] for n in (0, 2, 4, 5, 8, 9, 11, 1000)]
    assert along == pytest.approx([0.0, 1.0, 2.0, 1.5, 0.0, -0.5, 0.1, 0.8])
    assert moving.pose(1000).position_m[1] == pytest.approx(50.0)  # nothing is in its way there
    beside = Scene(hall, Pose((-0.9, 0.0, 0.6), 0.0), velocity_m_s=(1.0, 0.0), ping_period_s=0.5)
    assert beside.pose(2 * 58).position_m[0] == pytest.approx(-0.9)  # where it came from
    one_wall = Scene(Room((-np.inf, 2.3), (-1, 1)), START, velocity_m_s=(1, 0), ping_period_s=0.5)
    assert one_wall.pose(10).position_m[0] == pytest.approx(-1.0)


def test_dead_microphones_are_stuck_and_the_others_are_not():
    words = scene(dead_mics=(0, 17, 31)).hear(0, NUM_WORDS, CHIRP)
    changing = np.bitwise_or.reduce(words) & ~np.bitwise_and.reduce(words)
    assert int(changing) == 0xFFFFFFFF & ~(1 | 1 << 17 | 1 << 31)
    # Even rows rest low, odd ones high.
    assert int(np.bitwise_and.reduce(words)) == 1 << 17 | 1 << 31


def test_judging_a_ping_does_not_change_what_is_heard():
    made = scene(landmark(), stands=True, noise=(Tone(30e3, -60.0),))
    words, truth = made.hear_and_judge(3, NUM_WORDS, CHIRP)
    np.testing.assert_array_equal(words, made.hear(3, NUM_WORDS, CHIRP))
    plain = made.truth(3)
    assert truth["landmarks"][0].pop("own_to_rest_db") > 0
    assert truth == plain


def test_an_echo_stands_out_less_in_more_clutter_and_not_at_all_in_shadow():
    def ratio(**changes):
        return told_after(scene(landmark(), **changes))

    def told_after(made):
        return made.hear_and_judge(0, NUM_WORDS, CHIRP)[1]["landmarks"][0]["own_to_rest_db"]

    rng = np.random.default_rng(7)
    few, many = (Clutter.scatter((1.0, 3.0), (-1.0, 1.0), density, rng) for density in (3, 40))
    assert ratio() > ratio(clutter=few) > ratio(clutter=many)
    assert ratio() > 10
    assert ratio(things=(box(),)) is None


def test_the_ratio_of_one_echo_to_an_equal_one_is_nought():
    # Two dishes at one range, as far left as right: each is the other's only company.
    made = scene(landmark(2.0, 0.4), landmark(2.0, -0.4))
    lines = made.hear_and_judge(0, NUM_WORDS, CHIRP)[1]["landmarks"]
    for line in lines:
        assert line["own_to_rest_db"] == pytest.approx(0.0, abs=1.0)


def test_warm_air_brings_the_echo_earlier():
    def peak(temperature_c):
        made = scene(landmark(), air=Air(temperature_c, 50.0))
        audio = PdmDecoder().decode(made.hear(0, NUM_WORDS, CHIRP)).audio[9]
        matched = np.abs(scipy.signal.correlate(audio, CHIRP, "valid"))
        return (3_000 + np.argmax(matched[3_000:])) / 450e3

    by_speed = Air(0.0).speed_of_sound_m_s / Air(35.0).speed_of_sound_m_s
    assert peak(35.0) / peak(0.0) == pytest.approx(by_speed, abs=2e-3)


def test_a_stand_is_heard_below_its_landmark():
    bare, standing = scene(landmark()), scene(landmark(), stands=True)
    extra = len(standing.echoes(0).path_m) - len(bare.echoes(0).path_m)
    assert extra == 1


def noise_of(source, num_samples=16_384, yaw_rad=0.0, seed=1):
    size, rng = num_samples + 2 * MARGIN, np.random.default_rng(seed)
    spectrum = np.zeros((32, size // 2 + 1), np.complex64)
    add_sources(spectrum, size, num_samples, [source], yaw_rad, mic_positions_m(), 343.0, rng)
    return np.fft.irfft(spectrum, size, axis=1)[:, :num_samples].astype(float)


def test_a_whine_has_its_level_its_pitch_and_harmonics():
    pressure = noise_of(Tone(12e3, -50.0))
    spectrum = np.abs(np.fft.rfft(pressure[0] * np.hanning(16_384)))
    frequency_hz = np.fft.rfftfreq(16_384, 1 / 450e3)
    assert frequency_hz[np.argmax(spectrum)] == pytest.approx(12e3, rel=0.01)
    peaks = frequency_hz[scipy.signal.find_peaks(spectrum, spectrum.max() / 20)[0]]
    assert np.allclose(peaks / 12e3, [1, 2, 3, 4], rtol=0.01)
    rms_db = 10 * np.log10(np.mean(pressure**2))
    assert rms_db == pytest.approx(-50.0 + 10 * np.log10(1 + 0.158 + 0.04 + 0.016), abs=0.2)


@pytest.mark.parametrize("azimuth_deg", [-50.0, 0.0, 30.0])
def test_noise_comes_from_its_own_direction_whichever_way_the_sonar_looks(azimuth_deg):
    yaw_rad = 0.3
    pressure = noise_of(Tone(25e3, -50.0, np.deg2rad(azimuth_deg)), yaw_rad=yaw_rad)
    spectrum = np.fft.rfft(pressure, axis=1)
    row = np.argmax(np.abs(spectrum[0]))
    k = 2 * np.pi * np.fft.rfftfreq(16_384, 1 / 450e3)[row] / 343.0
    bearings = np.deg2rad(np.arange(-90, 90.5, 0.5))
    toward = np.stack([np.cos(bearings), np.sin(bearings), 0 * bearings], axis=1)
    beam = np.abs(np.exp(-1j * k * toward @ mic_positions_m().T) @ spectrum[:, row])
    found = bearings[np.argmax(beam)]
    assert found == pytest.approx(np.deg2rad(azimuth_deg) - yaw_rad, abs=np.deg2rad(1.5))


def test_an_air_gun_blows_now_and_then_and_hisses_in_the_sensors_band():
    levels = [np.mean(noise_of(AirGun(-40.0, 2.0, 0.15), seed=seed) ** 2) for seed in range(40)]
    # On the air for any part of 36 ms: 1 - exp(-2 * 0.186).
    assert np.mean(np.array(levels) > 0) == pytest.approx(0.31, abs=0.2)
    loud = noise_of(AirGun(-40.0, 1000.0, 0.15))
    power = np.mean(np.abs(np.fft.rfft(loud, axis=1)) ** 2, axis=0)
    frequency_hz = np.fft.rfftfreq(16_384, 1 / 450e3)
    inside, outside = (np.mean(power[np.abs(frequency_hz - at) < 5e3]) for at in (50e3, 100e3))
    assert inside > 50 * outside


def test_another_sonar_pings_at_its_own_rate_and_at_random_times():
    starts = []
    for seed in range(30):
        heard = noise_of(OtherSonar(-40.0, 40.0), seed=seed)[0]
        matched = np.abs(scipy.signal.correlate(heard, CHIRP, "valid"))
        peaks = scipy.signal.find_peaks(matched, 0.5 * np.sum(CHIRP**2) * 1e-2, distance=2000)[0]
        assert len(peaks) in (1, 2)
        if len(peaks) == 2:
            assert np.diff(peaks)[0] == pytest.approx(450e3 / 40.0, abs=3)
        starts.append(peaks[0])
    assert np.std(starts) > 2000


def test_reverberation_decays_and_differs_from_microphone_to_microphone():
    room = Room((-2.0, 5.0), (-3.0, 3.0), 0.7, diffuse=0.5)
    field = room.reverberation(32, np.random.default_rng(1))
    near, far = field.path_m.mean(axis=1) < 6.0, field.path_m.mean(axis=1) > 9.0
    assert np.mean(field.gain[near] ** 2) > 2 * np.mean(field.gain[far] ** 2)
    k = 2 * np.pi * 50e3 / 343.0
    waves = (field.gain * np.exp(1j * k * field.path_m)).sum(axis=0)
    assert np.abs(waves.mean()) < 0.5 * np.abs(waves).mean()


def test_reverberation_grows_with_the_square_of_its_factor_and_falls_with_the_room():
    def power(width_m, diffuse):
        room = Room((0.0, width_m), (0.0, 6.0), 0.8, diffuse=diffuse)
        return np.mean(room.reverberation(32, np.random.default_rng(1)).gain ** 2)

    assert power(7.0, 0.4) == pytest.approx(4 * power(7.0, 0.2), rel=1e-6)
    assert power(14.0, 0.4) < power(7.0, 0.4)
    assert OPEN.reverberation(32, np.random.default_rng(1)) is None
    assert Room(diffuse=0.0).reverberation(32, np.random.default_rng(1)) is None

import threading

import numpy as np
import pytest

from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP
from ertis_driver.device import Settings
from ertis_driver.errors import NotConfigured
from ertis_simulator.clutter import Clutter
from ertis_simulator.device import SimulatedSonar
from ertis_simulator.path import Pose
from ertis_simulator.room import Room
from ertis_simulator.scene import Scene

NUM_WORDS = 32_768
SCENE = Scene(
    Room(),
    Pose((0.0, 0.0, 0.6), 0.0),
    clutter=Clutter.scatter((1.0, 3.0), (-1.0, 1.0), 3.0, np.random.default_rng(1)),
    velocity_m_s=(0.2, 0.0),
    seed=4,
)


def expected(index, *, active=True, chirp=DEFAULT_CHIRP):
    return SCENE.hear(index, NUM_WORDS, chirp.samples(450e3) if active else None)


@pytest.fixture
def sonar():
    with SimulatedSonar(SCENE) as made:
        yield made


def test_frames_computed_ahead_are_those_of_their_pings(sonar):
    sonar.configure(Settings(num_words=NUM_WORDS))
    for index in range(5):
        frame = sonar.ping()
        assert frame.ping_index == index
        np.testing.assert_array_equal(frame.words, expected(index))


def test_a_passive_ping_between_active_ones_is_passive(sonar):
    sonar.configure(Settings(num_words=NUM_WORDS))
    for index, active in enumerate([True, False, True, True, False]):
        words = sonar.ping(active=active).words
        np.testing.assert_array_equal(words, expected(index, active=active))


def test_new_settings_hold_from_the_next_ping_on(sonar):
    sonar.configure(Settings(num_words=NUM_WORDS))
    sonar.ping()
    sonar.configure(Settings(INCUMBENT_CHIRP, NUM_WORDS, first_ping_index=1))
    frame = sonar.ping()
    assert frame.ping_index == 1
    np.testing.assert_array_equal(frame.words, expected(1, chirp=INCUMBENT_CHIRP))


def test_a_closed_sonar_leaves_no_thread_and_asks_to_be_configured(sonar):
    before = threading.active_count()
    sonar.configure(Settings(num_words=NUM_WORDS))
    sonar.ping()
    assert threading.active_count() > before
    sonar.close()
    sonar.close()
    assert threading.active_count() == before
    with pytest.raises(NotConfigured):
        sonar.ping()
    sonar.configure(Settings(num_words=NUM_WORDS))
    assert sonar.ping().ping_index == 1

import itertools
import threading
import time

from ertis_daemon.turns import FADE_S, PATIENCE_S, Turns

LISTENING_S = 0.02


def never():
    return False


class Pinger(threading.Thread):
    """Pings in turns; notes when each ping began and ended."""

    def __init__(self, turns, count, ping_s=LISTENING_S):
        super().__init__()
        self.turns, self.count, self.ping_s = turns, count, ping_s
        self.pings = []
        self.asked = []

    def run(self):
        for _ in range(self.count):
            self.asked.append(time.monotonic())
            with self.turns.turn(LISTENING_S, never) as ours:
                assert ours
                began = time.monotonic()
                time.sleep(self.ping_s)
                self.pings.append((began, time.monotonic()))


def run_all(*pingers):
    for one in pingers:
        one.start()
    for one in pingers:
        one.join()
    return sorted(
        (began, ended, index) for index, p in enumerate(pingers) for began, ended in p.pings
    )


def test_no_ping_begins_before_the_one_before_has_faded():
    turns = Turns()
    pings = run_all(*(Pinger(turns, 6) for _ in range(3)))
    assert len(pings) == 18
    for (began, _, _), (next_began, _, _) in itertools.pairwise(pings):
        assert next_began >= began + LISTENING_S + FADE_S


def test_each_gets_its_turn_before_anyone_gets_a_second():
    turns = Turns()
    pingers = [Pinger(turns, 8) for _ in range(3)]
    run_all(*pingers)
    pings = [
        (asked, began) for p in pingers for asked, (began, _) in zip(p.asked, p.pings, strict=True)
    ]
    for asked, began in pings:
        later = [start for other, start in pings if other > asked + 0.01]  # of who came after it
        assert all(start > began for start in later)


def test_one_that_never_ends_its_ping_loses_the_air_and_disturbs_nobody_afterwards():
    turns = Turns()
    has_it, let_go = threading.Event(), threading.Event()

    def hang():
        with turns.turn(LISTENING_S, never):
            has_it.set()
            let_go.wait(10.0)

    hanging = threading.Thread(target=hang)
    start = time.monotonic()
    hanging.start()
    has_it.wait()
    other = Pinger(turns, 1)
    other.start()
    other.join()
    assert hanging.is_alive(), "nobody waited for it to let go"
    assert other.pings[0][0] >= start + LISTENING_S + PATIENCE_S
    start = time.monotonic()
    with turns.turn(LISTENING_S, never):
        let_go.set()  # its late end must not free the air that is ours now
        hanging.join()
        late = Pinger(turns, 1)
        late.start()
        time.sleep(LISTENING_S + FADE_S + 0.03)
        released = time.monotonic()
    late.join()
    assert late.pings[0][0] >= min(released, start + LISTENING_S + PATIENCE_S)


def test_who_is_stopped_while_waiting_does_not_get_it_and_blocks_nobody():
    turns = Turns()
    stop = threading.Event()
    got = []

    def wait():
        with turns.turn(LISTENING_S, stop.is_set) as ours:
            got.append(ours)

    with turns.turn(LISTENING_S, never):
        waiting = threading.Thread(target=wait)
        waiting.start()
        time.sleep(0.03)
        stop.set()
        waiting.join()
    assert got == [False]
    after = Pinger(turns, 1)
    run_all(after)
    assert len(after.pings) == 1

"""A sonar whose cable is pulled in the middle of a frame, under ``ertis run``."""

import contextlib
import json
import time
from itertools import pairwise
from pathlib import Path

import pytest
from daemon_rig import status_of, wait_for

from ertis_driver.emulator import Emulator
from ertis_driver.fault_plan import NamedFaults, parse_fault
from ertis_driver.replay_source import ReplaySource

PROMISE_S = 2.0
UNPLUGGED = ("vanish@frame=4,byte=300000,away=0.4", "vanish@frame=12,byte=7,away=0.4")


def shown(seconds):
    return ", ".join(f"{s:.2f} s" for s in seconds)


def held_up_s(*processes):
    """How long the machine has made their threads wait for a processor, as it counts itself."""
    total_ns = 0
    for process in processes:
        for thread in Path(f"/proc/{process}/task").iterdir():
            with contextlib.suppress(OSError):  # it has ended
                total_ns += int((thread / "schedstat").read_text().split()[1])
    return total_ns / 1e9


@pytest.fixture
def processes():
    """The sonar's, which is the test's own, and the daemon's once there is one."""
    return ["self"]


@pytest.fixture
def plugged():
    """When it was plugged in again, each time: monotonic, s; host clock, ns; held up before, s."""
    return []


@pytest.fixture
def landmark_sonar(heard_landmarks, tmp_path, plugged, processes):
    """The daemon's sonar, which is unplugged twice and comes back."""
    with Emulator(
        ReplaySource(heard_landmarks),
        link=tmp_path / "port",
        faults=NamedFaults(map(parse_fault, UNPLUGGED)),
        on_plug=lambda path: plugged.append(
            (time.monotonic(), time.time_ns(), held_up_s(*processes))
        ),
    ) as emulator:
        yield emulator


def test_events_come_again_within_two_seconds_of_the_sonars_return(
    start_daemon, open_zenoh, free_locator, plugged, processes, capsys
):
    locator = free_locator()
    daemon = start_daemon("ping_rate_hz: 10\n", locator=locator)
    processes.append(daemon.process.pid)
    session = open_zenoh(locator)
    heard = []
    subscriber = session.declare_subscriber(
        "ertis/t/landmarks",
        lambda sample: heard.append(
            (time.monotonic(), json.loads(sample.payload.to_bytes()), held_up_s(*processes))
        ),
    )

    def events_after(when_ns):
        """Of pings after that: what was heard before may be told later."""
        return [one for one in heard if one[1]["ping_time_ns"] > when_ns]

    try:
        wait_for(lambda: daemon.check() and len(plugged) == 2 and events_after(plugged[1][1]))
        status = wait_for(lambda: (met := status_of(session)).get("state") == "running" and met)
    finally:
        subscriber.undeclare()
    took_s, waited_s = [], []
    for back_s, back_ns, held_up_before_s in plugged:
        at_s, _, held_up_after_s = events_after(back_ns)[0]
        took_s.append(at_s - back_s)
        waited_s.append(held_up_after_s - held_up_before_s)
    with capsys.disabled():
        print(f"\nevents again after {shown(took_s)}, held up for {shown(waited_s)} of it", end=" ")
    # Each time; what a busy machine kept from sonar and daemon is not theirs.
    assert max(took - waited for took, waited in zip(took_s, waited_s, strict=True)) <= PROMISE_S
    assert status["pings_away"] >= 2
    assert (status["starts"], status["pings_failed"]) == (1, 0)
    indices = [event["ping_index"] for _, event, _ in heard]
    assert all(later != sooner for sooner, later in pairwise(indices))

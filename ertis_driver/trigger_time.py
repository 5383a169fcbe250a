"""When a ping was triggered, from what the host saw of it."""

from __future__ import annotations

from ertis_driver.frame_reader import Arrival

USB_LATENCY_S = 1e-3  # a command waits for at most one full-speed USB frame
# How long after listening a device may begin to send: nobody has measured it.
SEND_LATENCY_S = 5e-3

Interval = tuple[float, float]


def commanded(before_s: float, after_s: float) -> Interval:
    """Interval of a trigger that the host wrote to the link between two instants, s."""
    return before_s, after_s + USB_LATENCY_S


def heard_of(arrival: Arrival, listening_s: float) -> Interval:
    """Interval of a trigger that the host only sees the frame of, s.

    Nobody knows whether the firmware sends while it listens or afterwards. Either way the first
    byte comes no earlier than the trigger, and no later than a send latency after listening; and
    the last one no earlier than the end of listening.

    Parameters
    ----------
    arrival
        The frame.
    listening_s
        How long the device listened, s.
    """
    earliest, latest = arrival.first_s
    earliest -= listening_s + SEND_LATENCY_S
    # A recording played by an emulator comes faster than it was listened to.
    return earliest, max(earliest, min(latest, arrival.last_s - listening_s))

"""Which microphones do not hear as they should, over several pings."""

from __future__ import annotations

import time
from collections import deque

import numpy as np
import numpy.typing as npt

from ertis_driver.audio import DecodedAudio
from ertis_driver.health import check_ping

PERIOD_S = 1.0  # a check takes 0.8 ms, and microphones do not die by the ping
AGREEING = 3  # checks in a row that find the same fault, or its end


class MicrophoneWatch:
    """Checks a ping a second. One loud or quiet ping is no fault; three in a row are.

    Parameters
    ----------
    period_s
        From one check to the next.

    Attributes
    ----------
    faulty : dict of str to str
        Row (bit of the PDM words) to state, as in ``ChannelHealth``; rows are text, as in JSON.
    noise_dbfs : float or None
        Median of the microphones that work, 20 to 80 kHz; None before the first check.
    """

    def __init__(self, period_s: float = PERIOD_S) -> None:
        self.faulty: dict[str, str] = {}
        self.noise_dbfs: float | None = None
        self._period_s = period_s
        self._due_s = 0.0
        self._found: deque[tuple[str, ...]] = deque(maxlen=AGREEING)

    @property
    def is_due(self) -> bool:
        """Whether the next ping should be checked."""
        return time.monotonic() >= self._due_s

    def check(self, words: npt.NDArray[np.uint32], decoded: DecodedAudio) -> tuple[str, ...]:
        """Look at one ping, of any number of words that ``check_ping`` takes.

        Returns
        -------
        tuple of str
            Rows that are found faulty since this ping.
        """
        self._due_s = time.monotonic() + self._period_s
        health = check_ping(words, decoded)
        self.noise_dbfs = health.usual_noise_dbfs
        self._found.append(health.states)
        if len(self._found) < AGREEING:
            return ()
        before = set(self.faulty)
        now = dict(self.faulty)
        for row, states in enumerate(zip(*self._found, strict=True)):
            if all(state != "ok" for state in states):
                now[str(row)] = states[-1]
            elif all(state == "ok" for state in states):
                now.pop(str(row), None)
        self.faulty = now
        return tuple(row for row in now if row not in before)

"""One ping as the sensor sends it, and the sensor's rates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

PDM_RATE_HZ = 4_500_000  # ultrasound mode (F = 0)
AUDIBLE_PDM_RATE_HZ = 1_125_000  # audible mode (F = 1): a frame lasts four times as long
DECIMATION = 10
AUDIO_RATE_HZ = PDM_RATE_HZ // DECIMATION
NUM_MICS = 32  # one bit of a PDM word each
DEFAULT_NUM_WORDS = 163_840  # 36.4 ms: 6.2 m of range at 343 m/s

Source = Literal["live", "replay", "sim"]


@dataclass(frozen=True, slots=True, eq=False)
class PdmFrame:
    """What the 32 microphones heard after one ping.

    words : uint32, shape (num_words,)
        Bit ``m`` of ``words[n]`` is microphone ``m``'s PDM bit, ``n / pdm_rate_hz`` s in.
    ping_index : int
        The device's own counter, modulo 2**32. A gap is a lost ping.
    ping_time_ns : int
        Host clock (UNIX epoch, ns) when the ping was triggered, not when its data arrived.
    time_uncertainty_ns : int
        Half-width of the interval in which the trigger happened.
    active : bool
        A chirp was emitted; False means the sonar only listened.
    pdm_rate_hz : int
        Words a second: 4,500,000, or 1,125,000 in audible mode.
    clock_step_ns : int
        How far the host clock was set (forward is positive) since the ping before. Not 0: times
        before and from this ping on do not compare.
    """

    words: npt.NDArray[np.uint32]
    ping_index: int
    ping_time_ns: int
    time_uncertainty_ns: int = 0
    active: bool = True
    pdm_rate_hz: int = PDM_RATE_HZ
    clock_step_ns: int = 0

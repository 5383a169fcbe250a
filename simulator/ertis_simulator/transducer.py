"""The emitter: response on axis (with the microphones'), loudness, ring-down."""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

# Amplitude (full scale = 1) at 1 m on axis at 50 kHz. With it a wall at 3.2 m returns -22 dBFS and
# the direct path reaches about full scale, both as in the one real ping.
AMPLITUDE_AT_1M = 1.0
# After the chirp the housing rings: 14 dB under the direct path, then 7.5 dB/ms down (real ping).
RING_DOWN_START_DB = -16.0
RING_DOWN_DB_PER_MS = 7.5
RING_DOWN_S = 8e-3


@cache
def _response_table() -> npt.NDArray[np.float64]:
    text = (resources.files("ertis_simulator") / "data/sensor_response.csv").read_text()
    lines = [line for line in text.splitlines() if line[:1].isdigit()]
    return np.loadtxt(lines, delimiter=",")


def sensor_response(frequency_hz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Amplitude of transducer and microphones on axis, 1 at 50 kHz; any shape, Hz in."""
    table = _response_table()
    level_db = np.interp(frequency_hz, table[:, 0], table[:, 1])
    return np.asarray(10 ** (level_db / 20))

"""The decimation filter that every audio sample passes: integer taps, so exact in float32.

Designed once, by::

    h = scipy.signal.remez(80, [0, 100e3, 350e3, 2.25e6], [1, 0], weight=[1, 30], fs=4.5e6)
    q = round(h / sum(h) * 2**23), made symmetric, the two centre taps adjusted to sum(q) == 2**23

Flat to +-0.011 dB up to 100 kHz; what would fold onto 0-100 kHz (from 350 kHz) is 87 dB down.
sum(|q|) < 2**24, so each partial sum of +-1 inputs is an integer that float32 holds exactly:
the same bits from every BLAS, thread count and CPU.
"""

import numpy as np
import numpy.typing as npt

from ertis_driver.frame import DECIMATION

FILTER_VERSION = "remez80-1"  # stored in models: features of other filters are not interchangeable
UNITY = 2**23  # sum of the taps: divide by it

_HALF = (
    -364,
    -494,
    -713,
    -860,
    -823,
    -462,
    368,
    1_800,
    3_913,
    6_696,
    10_011,
    13_569,
    16_914,
    19_437,
    20_421,
    19_108,
    14_804,
    6_992,
    -4_534,
    -19_549,
    -37_306,
    -56_481,
    -75_180,
    -91_023,
    -101_282,
    -103_105,
    -93_781,
    -71_029,
    -33_296,
    19_992,
    88_237,
    169_578,
    260_912,
    358_039,
    455_921,
    549_043,
    631_841,
    699_149,
    746_641,
    771_200,
)
TAPS = np.array(_HALF + _HALF[::-1], dtype=np.int32)
TAPS.setflags(write=False)
# Output k is centred 0.5 PDM samples (0.11 us, 0.02 mm of range) after word 10 k.
LEAD = TAPS.size // 2 - 1
RESPONSE_REACH = 8  # audio samples on either side of a bit, beyond which it is not heard


def bit_response(position: int, outputs: npt.NDArray[np.intp]) -> npt.NDArray[np.float64]:
    """What one +1 bit at word ``position`` adds to the audio samples ``outputs``."""
    tap = position - outputs * DECIMATION + LEAD
    inside = (tap >= 0) & (tap < TAPS.size)
    return np.asarray(np.where(inside, TAPS[np.clip(tap, 0, TAPS.size - 1)], 0) / UNITY)


def _responses() -> npt.NDArray[np.float64]:
    places = RESPONSE_REACH * DECIMATION + np.arange(DECIMATION)
    outputs = np.arange(2 * RESPONSE_REACH)
    rows = np.array([bit_response(place, outputs) for place in places.tolist()])
    rows.setflags(write=False)
    return rows


# ``bit_response`` within reach, for each place of a word in its audio sample: (10, 16).
RESPONSES = _responses()

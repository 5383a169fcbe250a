"""Where the microphones and the emitter sit, in the sensor frame (x forward, y left, z up; m)."""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from ertis_driver.frame import NUM_MICS

# One fit on a real ping; acoustics.md of the project: 51 mm above the array centre, 0.7 mm left.
EMITTER_POSITION_M = (0.0, 0.0007, 0.051)


@cache
def mic_positions_m() -> npt.NDArray[np.float64]:
    """Positions of the 32 microphones of an eRTIS v3D1, origin at their mean.

    Returns
    -------
    float64, shape (32, 3), read-only
        Row ``m`` belongs to bit ``m`` of a PDM word.
    """
    text = (resources.files("ertis_driver") / "data/microphones_ertis_v3d1.csv").read_text()
    table = np.loadtxt(text.splitlines(), delimiter=",", skiprows=1)
    if table.shape != (NUM_MICS, 3):
        raise ValueError(f"microphone table has shape {table.shape}, expected ({NUM_MICS}, 3)")
    plane_m = table[:, 1:] / 1000.0
    plane_m -= plane_m.mean(axis=0)
    positions = np.column_stack([np.zeros(NUM_MICS), plane_m])
    positions.setflags(write=False)
    return positions

"""The picture of a ping that a recording gives to viewers: its energyscape from above."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ertis_daemon.recordings.png import encode_png, palette, stamp
from ertis_detector.imaging import Energyscape
from ertis_driver.frame import Source

PIXEL_M = 0.02
SPAN_DB = 45.0
_WIDENED_CELLS = 7  # an echo is 6 mm thin: 4 cm can be seen
_STAMPS: dict[Source, str] = {"live": "", "sim": "SIMULATED", "replay": "REPLAY"}


class ScenePicture:
    """Draws energyscapes of one imager as PNG, forward up and left on the left.

    Parameters
    ----------
    source
        A simulated or replayed ping is called so in the picture.
    """

    def __init__(self, source: Source) -> None:
        self._stamp = _STAMPS[source]
        self._colours = palette()
        self._cells: npt.NDArray[np.intp] | None = None
        self._of: tuple[int, ...] = ()

    def draw(self, scape: Energyscape) -> bytes:
        """A PNG file: 0 to 45 dB over the noise floor, 2 cm a pixel, the sonar in the middle."""
        power = scape.power
        padded = np.pad(power, ((0, 0), (_WIDENED_CELLS // 2, _WIDENED_CELLS // 2)))
        wide = padded[:, : power.shape[1]].copy()
        for shift in range(1, _WIDENED_CELLS):
            np.maximum(wide, padded[:, shift : shift + power.shape[1]], out=wide)
        floor = scape.noise_floor
        level_db = 10 * np.log10(np.maximum(wide, floor) / np.float32(floor))
        shades = np.rint(np.minimum(level_db / SPAN_DB, 1) * 255).astype(np.uint8)
        flat = np.append(shades.reshape(-1), np.uint8(0))  # the last: what lies outside
        pixels = flat[self._pixel_cells(scape)]
        stamp(pixels, self._stamp)
        return encode_png(pixels, self._colours)

    def _pixel_cells(self, scape: Energyscape) -> npt.NDArray[np.intp]:
        """For each pixel, which cell of the energyscape it shows."""
        if self._cells is None or self._of != scape.power.shape:
            self._cells, self._of = _pixel_cells(scape), scape.power.shape
        return self._cells


def _pixel_cells(scape: Energyscape) -> npt.NDArray[np.intp]:
    ranges_m, azimuths = scape.range_m, scape.azimuth_rad
    far_m, aside_m = ranges_m[-1], ranges_m[-1] * np.sin(np.abs(azimuths).max())
    forward = np.arange(int(far_m / PIXEL_M), -1, -1)[:, None] * PIXEL_M
    half = int(aside_m / PIXEL_M)
    left = np.arange(half, -half - 1, -1)[None, :] * PIXEL_M
    range_m, azimuth = np.hypot(forward, left), np.arctan2(left, forward)
    step_m = ranges_m[1] - ranges_m[0]
    cell = np.rint((range_m - ranges_m[0]) / step_m).astype(np.intp)
    middles = (azimuths[1:] + azimuths[:-1]) / 2
    direction = np.searchsorted(middles, azimuth)
    inside = (cell >= 0) & (cell < ranges_m.size)
    inside &= (azimuth >= azimuths[0]) & (azimuth <= azimuths[-1])
    return np.where(inside, direction * ranges_m.size + cell, scape.power.size)

"""A simulated ping beside the real one: same chirp, same two strong echoes, nothing else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION, DEFAULT_NUM_WORDS
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.microphone import MicrophoneSet, add_noise, corrupt_half_words, to_pdm
from ertis_simulator.propagation import render
from ertis_simulator.transducer import direct_path

FloatArray = npt.NDArray[np.float64]
AIR = Air(20.0, 50.0)  # nobody wrote down the weather


@dataclass(frozen=True, slots=True)
class StrongEcho:
    """A reflector of the real ping: where it was found, and how strong, as a point on the axis."""

    range_m: float
    azimuth_deg: float
    elevation_deg: float
    length_m: float

    def position_m(self) -> FloatArray:
        """In the sensor frame, shape (3,)."""
        azimuth, elevation = np.deg2rad(self.azimuth_deg), np.deg2rad(self.elevation_deg)
        level = np.cos(elevation)
        return np.array(
            [
                self.range_m * level * np.cos(azimuth),
                self.range_m * level * np.sin(azimuth),
                self.range_m * np.sin(elevation),
            ]
        )

    def path_m(self) -> FloatArray:
        """Emitter to reflector to each microphone, shape (32,)."""
        there = np.linalg.norm(self.position_m() - np.array(EMITTER_POSITION_M))
        back = np.linalg.norm(self.position_m() - mic_positions_m(), axis=1)
        return np.asarray(there + back)


# Found by beamforming the real ping; strengths make the levels at 46 kHz equal. On the axis perfect
# walls would have 1.60 and 1.87, half the range.
ECHOES = (StrongEcho(3.210, -7.7, 4.0, 1.89), StrongEcho(3.747, 5.5, 0.0, 1.61))


def twin(seed: int) -> npt.NDArray[np.uint32]:
    """Words of the simulated ping; another sonar, ring-down and noise for each seed."""
    rng = np.random.default_rng(seed)
    mics = MicrophoneSet.draw(rng)
    emitter = np.array(EMITTER_POSITION_M)
    parts = [direct_path(emitter, mic_positions_m(), AIR.speed_of_sound_m_s, rng)]
    for echo in ECHOES:
        spread = echo.length_m / (echo.path_m() / 2) ** 2
        parts.append(Echoes.of(echo.path_m(), spread))
    chirp = INCUMBENT_CHIRP.samples(AUDIO_RATE_HZ)
    num_samples = DEFAULT_NUM_WORDS // DECIMATION
    pressure = render(Echoes.join(parts), AIR, chirp, num_samples, mics.response)
    add_noise(pressure, rng)
    words = to_pdm(pressure, rng)
    corrupt_half_words(words, mics.half_words_per_frame, rng)
    return words

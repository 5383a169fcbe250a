"""How well each microphone hears, judged from one ping: see docs/signals.md for the reasons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from statistics import median
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ertis_driver.audio import DecodedAudio
from ertis_driver.bit_runs import STARTUP_WORDS, long_runs, stuck_mics, twin_mics
from ertis_driver.frame import AUDIO_RATE_HZ, DECIMATION, NUM_MICS, PDM_RATE_HZ

ChannelState = Literal["ok", "stuck", "interrupted", "silent", "twin", "weak", "noisy"]

NOISE_BAND_HZ = (20_000.0, 80_000.0)
DIRECT_PATH_S = 3e-3  # the chirp on its shortest way: where every microphone must hear it
# 25 dB below the self-noise of these microphones (-55 dBFS): no microphone is at work.
SILENT_DBFS = -80.0
# On a real ping levels spread by -5 to +3 dB (distance, angle and gain), noise by 2 dB.
TOLERANCE_DB = 10.0
# The shaped noise alone is at -39 dBFS, a direct path at -10: only a chirp tells who is weak.
CHIRP_LEVEL_DBFS = -30.0
_FLOOR_DBFS = -160.0  # what float32 can tell from nothing

_STRETCHES, _STRETCH_SAMPLES = 4, 256
_TAIL_SAMPLES = _STRETCHES * _STRETCH_SAMPLES  # 2.3 ms, the last of the frame


@dataclass(frozen=True, slots=True)
class ChannelHealth:
    """One microphone in one ping. 0 dBFS is an RMS of 1.

    row : int
        Bit of the PDM words, and row of ``mic_positions_m``.
    state : str
        ``ok``; ``stuck``: its bit never changes; ``interrupted``: it did not for 57 us or longer;
        ``silent``: bits change, but carry not even a microphone's own noise; ``twin``: the very
        bits of another row; ``weak``: 10 dB below the median in level or noise; ``noisy``: 10 dB
        above it in noise.
    twin : int or None
        Row with the same bits.
    noise_dbfs : float
        20 to 80 kHz, in the last 2.3 ms of the frame. Late echoes count as noise.
    level_dbfs : float
        RMS of the first 3 ms.
    saturated_s : float
        How long it was beyond its range, all in all, s.
    saturated_until_s : float
        When that last was, s after word 0; 0 if never.
    """

    row: int
    state: ChannelState
    twin: int | None
    noise_dbfs: float
    level_dbfs: float
    saturated_s: float
    saturated_until_s: float


@dataclass(frozen=True, slots=True)
class PingHealth:
    """All microphones in one ping: columns by row, as in ``ChannelHealth``.

    usual_noise_dbfs : float or None
        Median of the microphones that work, 20 to 80 kHz; None if none does.
    half_words_repaired : int
        Corrupt half-words found by bit pattern and click, and mended.
    """

    states: tuple[ChannelState, ...]
    twins: Mapping[int, int]
    noise_dbfs: tuple[float, ...]
    level_dbfs: tuple[float, ...]
    saturated_s: tuple[float, ...]
    saturated_until_s: tuple[float, ...]
    usual_noise_dbfs: float | None
    half_words_repaired: int

    def channel(self, row: int) -> ChannelHealth:
        """One microphone."""
        return ChannelHealth(
            row,
            self.states[row],
            self.twins.get(row),
            self.noise_dbfs[row],
            self.level_dbfs[row],
            self.saturated_s[row],
            self.saturated_until_s[row],
        )

    @property
    def faulty(self) -> tuple[ChannelHealth, ...]:
        """The microphones that are not ``ok``."""
        rows = (row for row, state in enumerate(self.states) if state != "ok")
        return tuple(self.channel(row) for row in rows)

    @property
    def saturated(self) -> tuple[ChannelHealth, ...]:
        """The microphones that clipped; near the emitter, a chirp does that to healthy ones."""
        rows = (row for row, time_s in enumerate(self.saturated_s) if time_s > 0)
        return tuple(self.channel(row) for row in rows)

    def to_json(self) -> dict[str, Any]:
        """As plain values; columns have one entry a microphone."""
        names = ("usual_noise_dbfs", "half_words_repaired", "states", "noise_dbfs", "level_dbfs")
        return {
            name: list(value) if isinstance(value := getattr(self, name), tuple) else value
            for name in (*names, "saturated_s", "saturated_until_s")
        }


def check_ping(words: npt.NDArray[np.uint32], decoded: DecodedAudio) -> PingHealth:
    """Judge one ping, in less than a millisecond.

    Parameters
    ----------
    words : uint32, shape (num_words,)
        At 4.5 MHz; a whole frame, of at least 32768 words.
    decoded : DecodedAudio
        The same frame as audio.

    Raises
    ------
    ValueError
        If the frame is shorter than the tail that noise is measured on.
    """
    audio = decoded.audio
    if audio.shape[1] < _TAIL_SAMPLES + STARTUP_WORDS // DECIMATION:
        raise ValueError(
            f"audio of {audio.shape[1]} samples, expected {_TAIL_SAMPLES} or more after start-up"
        )
    stuck = stuck_mics(words)
    runs = long_runs(words, ignore=stuck)
    noise, level = noise_dbfs(audio).tolist(), level_dbfs(audio).tolist()
    states = _dead_or_ok(stuck, runs.interrupted, noise)
    working = [mic for mic, state in enumerate(states) if state == "ok"]
    twins = {mic: other for mic, other in twin_mics(words).items() if mic in working}
    usual_noise = median(noise[mic] for mic in working) if working else None
    if usual_noise is not None:
        usual_level = median(level[mic] for mic in working)
        for mic in working:
            compared = _compared(noise[mic] - usual_noise, level[mic], usual_level)
            states[mic] = "twin" if mic in twins else compared
    return PingHealth(
        states=tuple(states),
        twins=twins,
        noise_dbfs=tuple(noise),
        level_dbfs=tuple(level),
        saturated_s=tuple(count / PDM_RATE_HZ for count in runs.total_words),
        saturated_until_s=tuple(word / PDM_RATE_HZ for word in runs.end_word),
        usual_noise_dbfs=usual_noise,
        half_words_repaired=decoded.half_words_repaired,
    )


def noise_dbfs(audio: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """Noise of each microphone from 20 to 80 kHz in the last 2.3 ms; median of four stretches.

    The median passes over a click, and over a late echo that is shorter than half of it.

    Parameters
    ----------
    audio : float32, shape (32, num_samples)

    Returns
    -------
    float64, shape (32,), dBFS
    """
    tail = np.ascontiguousarray(audio[:, -_TAIL_SAMPLES:]).reshape(-1, _STRETCH_SAMPLES)
    lines = tail @ _band_transform()
    power = np.einsum("sf,sf->s", lines, lines).reshape(NUM_MICS, _STRETCHES)
    power.sort(axis=1)
    return _to_db(power[:, _STRETCHES // 2 - 1 : _STRETCHES // 2 + 1].mean(axis=1))


def level_dbfs(audio: npt.NDArray[np.float32]) -> npt.NDArray[np.float64]:
    """RMS of each microphone in the first 3 ms, after start-up; float64, shape (32,), dBFS."""
    first, last = STARTUP_WORDS // DECIMATION + 8, round(DIRECT_PATH_S * AUDIO_RATE_HZ)
    part = audio[:, first:last]
    mean = part.mean(axis=1)
    return _to_db(np.einsum("ms,ms->m", part, part) / part.shape[1] - mean * mean)


@cache
def _band_transform() -> npt.NDArray[np.float32]:
    """Tapered Fourier lines of the noise band only: a tenth of an FFT's work. Shape (256, 68).

    Scaled so that the lines' squares add up to the band's mean square.
    """
    bins_hz = np.fft.rfftfreq(_STRETCH_SAMPLES, 1 / AUDIO_RATE_HZ)
    bins_hz = bins_hz[(bins_hz >= NOISE_BAND_HZ[0]) & (bins_hz < NOISE_BAND_HZ[1])]
    phase = 2 * np.pi / AUDIO_RATE_HZ * np.outer(np.arange(_STRETCH_SAMPLES), bins_hz)
    taper = np.hanning(_STRETCH_SAMPLES)
    scale = np.sqrt(2.0 / (_STRETCH_SAMPLES * np.sum(taper**2)))
    lines = np.concatenate([np.cos(phase), np.sin(phase)], axis=1) * taper[:, None] * scale
    return np.asarray(lines.astype(np.float32))


def _to_db(power: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    floor = 10 ** (_FLOOR_DBFS / 10)
    return np.asarray(10 * np.log10(np.maximum(power.astype(np.float64), floor)))


def _dead_or_ok(stuck: int, interrupted: int, noise: list[float]) -> list[ChannelState]:
    states: list[ChannelState] = ["silent" if db < SILENT_DBFS else "ok" for db in noise]
    for mic in range(NUM_MICS):
        if stuck >> mic & 1:
            states[mic] = "stuck"
        elif interrupted >> mic & 1:
            states[mic] = "interrupted"
    return states


def _compared(excess_noise_db: float, level: float, usual_level: float) -> ChannelState:
    if excess_noise_db > TOLERANCE_DB:
        return "noisy"
    is_faint = usual_level > CHIRP_LEVEL_DBFS and level < usual_level - TOLERANCE_DB
    return "weak" if is_faint or excess_noise_db < -TOLERANCE_DB else "ok"

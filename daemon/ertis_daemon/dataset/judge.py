"""Whether a ping is what its label claims, and whether the sonar heard it well."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ertis_daemon.dataset.echo_gate import WEAK_DB, EchoGate
from ertis_daemon.dataset.label import Label
from ertis_detector.air import Air
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.chirp import Emission
from ertis_driver.dataset import NONE
from ertis_driver.direct_path import find_direct_path
from ertis_driver.frame import PDM_RATE_HZ, PdmFrame
from ertis_driver.health import DIRECT_PATH_S, ChannelHealth, check_ping

GOOD, WEAK, SILENT, CLIPPED, MICROPHONES = "good", "weak", "silent", "clipped", "microphones"
# Weak and noisy ones still hear; these do not.
_DEAD = ("stuck", "interrupted", "silent", "twin")


@dataclass(frozen=True, slots=True)
class Judgement:
    """What one ping told.

    echo_db : float
        Echo at the claimed range over what is around; NaN if none is claimed or it cannot be told.
    dead_microphones : tuple of ChannelHealth
    notes : dict
        What is wrong: a word (``weak`` ...) for the table, a sentence for people.
    """

    echo_db: float
    dead_microphones: tuple[ChannelHealth, ...]
    notes: dict[str, str]

    @property
    def quality(self) -> str:
        """For the table: ``good``, or the words for what is wrong."""
        return " ".join(self.notes) or GOOD


class Judge:
    """Judges pings of one chirp and length. Not for use by two threads at once.

    Parameters
    ----------
    chirp
        What was emitted.
    num_words : int
        Of each ping.
    """

    def __init__(self, chirp: Emission, num_words: int) -> None:
        self._chirp = chirp
        self._num_words = num_words
        self._decoder = PdmDecoder()
        self._gates: dict[float, EchoGate] = {}

    def judge(self, frame: PdmFrame, label: Label, temperature_c: float) -> Judgement:
        """Judge one active ping at 4.5 MHz.

        Raises
        ------
        ValueError
            If it is too short to tell anything, or of another PDM clock.
        """
        if frame.pdm_rate_hz != PDM_RATE_HZ:
            raise ValueError(f"PDM clock {frame.pdm_rate_hz} Hz, expected {PDM_RATE_HZ}")
        words = whole_samples(frame.words)
        decoded = self._decoder.decode(words)
        health = check_ping(words, decoded)
        found: dict[str, str] = {}
        if not find_direct_path(decoded.audio, self._chirp).heard:
            found[SILENT] = "the chirp was not heard on its way out: look at the emitter"
        dead = tuple(channel for channel in health.faulty if channel.state in _DEAD)
        if dead:
            named = ", ".join(f"{channel.row} {channel.state}" for channel in dead)
            found[MICROPHONES] = f"microphone {named}: look at its supply and solder joints"
        late_s = DIRECT_PATH_S + self._chirp.duration_s
        clipped = [c.row for c in health.saturated if c.saturated_until_s > late_s]
        if clipped:
            rows = ", ".join(map(str, clipped))
            found[CLIPPED] = f"microphone {rows} clips on an echo: move away, or turn"
        echo_db = math.nan
        if label.label != NONE:
            gate = self._gate(temperature_c)
            echo_db = gate.level_db(decoded.audio, label.range_m, label.azimuth_rad)
            if not echo_db >= WEAK_DB:
                range_m, level_db = gate.clearest(decoded.audio, label.azimuth_rad)
                found[WEAK] = _missing(label.range_m, echo_db, range_m, level_db)
        return Judgement(echo_db, dead, found)

    def _gate(self, temperature_c: float) -> EchoGate:
        if temperature_c not in self._gates:
            self._gates.clear()  # a temperature a session: the one before is over
            speed_m_s = Air(temperature_c).speed_of_sound_m_s
            self._gates[temperature_c] = EchoGate(self._chirp, self._num_words, speed_m_s)
        return self._gates[temperature_c]


def _missing(claimed_m: float, echo_db: float, range_m: float, level_db: float) -> str:
    if math.isnan(echo_db):
        return f"{claimed_m:.2f} m cannot be heard: too near, or beyond the end of the ping"
    return (
        f"no echo at {claimed_m:.2f} m ({echo_db:.1f} dB over what is around, expected "
        f"{WEAK_DB:g}): the clearest toward there is at {range_m:.2f} m ({level_db:.0f} dB)"
    )

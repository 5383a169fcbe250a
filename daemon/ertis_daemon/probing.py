"""Pinging a sonar to find out how it is; knows no terminal."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field

from ertis_daemon.chirp_guess import guess_chirp
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.chirp import Emission
from ertis_driver.device import DeviceInfo, Settings, Sonar
from ertis_driver.direct_path import DirectPath, find_direct_path
from ertis_driver.errors import DeviceTimeout, EndOfRecording, FrameCorrupt, SettingsError
from ertis_driver.frame import PDM_RATE_HZ, PdmFrame
from ertis_driver.health import ChannelState, PingHealth, check_ping
from ertis_driver.ping_counter import missing_between

# Saturated past the chirp's own length plus this (17 cm of range), it is no direct path.
SATURATED_AFTER_CHIRP_S = 1e-3


@dataclass(slots=True)
class Probe:
    """What pinging told.

    settings : Settings
        Used for all pings; a recording keeps its own.
    chirp_heard : Chirp or CustomChirp
        What the direct path was searched for: the chirp of the settings, or what a replayed
        recording sounds like.
    passive, active : PingHealth or None
        Of the first ping of each kind that was heard.
    direct_paths : list of DirectPath
        One for each active ping heard.
    chirp_in_passive : bool
        The passive ping heard a direct path.
    faults : Counter of (row, state)
        In how many pings, of both kinds.
    late_saturation : Counter of row
        In how many pings, of both kinds, that was saturated when no direct path explains it.
    half_words : list of int
        Mended in each ping heard.
    failures : list of str
        Messages of the pings that failed.
    skipped : int
        Pings that the device's counter passed over, without those that failed.
    ping_s : float
        Time spent in the active pings heard, s.
    """

    info: DeviceInfo
    settings: Settings
    chirp_heard: Emission
    asked: int
    passive: PingHealth | None = None
    active: PingHealth | None = None
    direct_paths: list[DirectPath] = field(default_factory=list)
    chirp_in_passive: bool = False
    faults: Counter[tuple[int, ChannelState]] = field(default_factory=Counter)
    late_saturation: Counter[int] = field(default_factory=Counter)
    half_words: list[int] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    skipped: int = 0
    ping_s: float = 0.0

    @property
    def pings_per_s(self) -> float | None:
        """Rate of active pings; None for a recording, which has no pace of its own."""
        if self.info.address.startswith("replay:") or self.ping_s <= 0:
            return None
        return len(self.direct_paths) / self.ping_s


class Prober:
    """Pings one sonar and keeps count.

    Parameters
    ----------
    sonar
        Open; it is configured here.
    settings
        Asked of it.
    pings
        Active pings, after one passive ping.

    Raises
    ------
    DeviceError
        If it cannot be configured.
    SettingsError
        If it is a recording of audible sound.
    """

    def __init__(self, sonar: Sonar, settings: Settings, pings: int) -> None:
        self._sonar = sonar
        self._decoder = PdmDecoder()
        self._last_index: int | None = None
        sonar.configure(sonar.settings or settings)
        used = sonar.settings or settings
        if used.pdm_rate_hz != PDM_RATE_HZ:
            raise SettingsError(
                f"{sonar.info.address} listened at {used.pdm_rate_hz} Hz, expected {PDM_RATE_HZ}: "
                "only ultrasound can be judged"
            )
        self._probe = Probe(sonar.info, used, used.chirp, pings)

    def run(self) -> Probe:
        """Ping.

        Raises
        ------
        DeviceError
            If the sonar went away, or if not one ping was heard: the last failure.
        EndOfRecording
            If a recording holds no ping.
        """
        failure: Exception | None = None
        for active in (False, *[True] * self._probe.asked):
            started_s = time.monotonic()
            try:
                frame = self._sonar.ping(active=active)
            except (DeviceTimeout, FrameCorrupt) as error:
                failure = error
                self._probe.failures.append(str(error))
                continue
            except EndOfRecording as error:
                failure = failure or error
                break
            # A recording gives the ping that comes next, of whatever kind.
            if frame.active:
                self._probe.ping_s += time.monotonic() - started_s
            self._take(frame)
        probe = self._probe
        probe.skipped = max(0, probe.skipped - len(probe.failures))
        if not probe.half_words and failure is not None:
            raise failure
        return probe

    def _take(self, frame: PdmFrame) -> None:
        probe = self._probe
        words = whole_samples(frame.words)
        decoded = self._decoder.decode(words)
        health = check_ping(words, decoded)
        if probe.info.source == "replay":
            # The emulator plays a recording whatever chirp it was given.
            probe.chirp_heard = guess_chirp(decoded.audio) or probe.chirp_heard
        path = find_direct_path(decoded.audio, probe.chirp_heard)
        if frame.active:
            probe.active = probe.active or health
            probe.direct_paths.append(path)
        else:
            probe.passive = probe.passive or health
            probe.chirp_in_passive = path.heard
        probe.half_words.append(health.half_words_repaired)
        probe.faults.update((channel.row, channel.state) for channel in health.faulty)
        emitted = frame.active or path.heard
        explained_s = probe.chirp_heard.duration_s + SATURATED_AFTER_CHIRP_S if emitted else 0.0
        probe.late_saturation.update(
            channel.row for channel in health.saturated if channel.saturated_until_s > explained_s
        )
        self._count_skipped(frame.ping_index)

    def _count_skipped(self, index: int) -> None:
        if self._last_index is not None:
            self._probe.skipped += missing_between(self._last_index, index)
        self._last_index = index

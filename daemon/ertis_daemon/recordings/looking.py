"""How pings sound while they are recorded: level, clipping, dead microphones; and a picture."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.frame import PDM_RATE_HZ, PdmFrame, Source
from ertis_driver.health import DIRECT_PATH_S, PingHealth, check_ping

if TYPE_CHECKING:
    from ertis_daemon.recordings.scene_channel import ScenePicture
    from ertis_detector.air import Air
    from ertis_detector.scanner import Scanner
    from ertis_driver.device import Settings


@dataclass(frozen=True, slots=True)
class Look:
    """One ping, looked at.

    level_dbfs : float
        Median over the microphones of the RMS of the first 3 ms, where the chirp itself is.
    clipped : int
        Microphones beyond their range after the direct path: echoes that are too loud.
    faulty : tuple of (row, state)
        As ``health.ChannelHealth`` has it.
    picture : bytes
        PNG, or empty.
    """

    level_dbfs: float
    clipped: int
    faulty: tuple[tuple[int, str], ...]
    picture: bytes = b""

    def __str__(self) -> str:
        """For the live line."""
        text = f"level {self.level_dbfs:.1f} dBFS"
        if self.clipped:
            text += f", {self.clipped} microphones clip"
        return text + (f", {name_faulty(self.faulty)}" if self.faulty else "")


class Looker:
    """Looks at pings; 5 to 25 ms each.

    Parameters
    ----------
    settings
        The sonar's.
    temperature_c : float
        Of the air.
    source
        Who makes the pings.
    pictures
        Also draw them; not done if the chirp leaves nothing to image.

    Attributes
    ----------
    why_no_pictures : str
        Empty if they are drawn, or not wanted.
    faults : Counter
        Of (row, state), over all pings looked at.
    """

    def __init__(
        self,
        settings: Settings,
        air: Air,
        source: Source,
        *,
        pictures: bool = True,
    ) -> None:
        self.why_no_pictures = ""
        self.faults: Counter[tuple[int, str]] = Counter()
        self.looked = 0
        self._decoder = PdmDecoder()
        self._scanner: Scanner | None = None
        self._picture: ScenePicture | None = None
        if pictures:
            self._prepare_pictures(settings, air, source)

    def _prepare_pictures(self, settings: Settings, air: Air, source: Source) -> None:
        from ertis_daemon.pipeline import build_scanner
        from ertis_daemon.recordings.scene_channel import ScenePicture
        from ertis_detector.errors import DetectorError
        from ertis_driver.errors import SettingsError

        try:
            self._scanner = build_scanner(settings, air)
        except (DetectorError, SettingsError) as error:
            self.why_no_pictures = str(error)
        self._picture = ScenePicture(source)

    def look(self, frame: PdmFrame) -> Look | None:
        """Judge a ping; None at the audible clock, which none of this is made for."""
        if frame.pdm_rate_hz != PDM_RATE_HZ:
            return None
        words = whole_samples(frame.words)
        decoded = self._decoder.decode(words)
        health = check_ping(frame.words, decoded)
        self.looked += 1
        self.faults.update((channel.row, channel.state) for channel in health.faulty)
        picture = b""
        if self._scanner is not None and self._picture is not None:
            picture = self._picture.draw(self._scanner.image(decoded.audio)[1])
        return _look(health, picture)


def _look(health: PingHealth, picture: bytes) -> Look:
    from statistics import median

    dead = {channel.row for channel in health.faulty if channel.state == "stuck"}
    clipped = [
        channel
        for channel in health.saturated
        if channel.saturated_until_s > DIRECT_PATH_S and channel.row not in dead
    ]
    faulty = tuple((channel.row, str(channel.state)) for channel in health.faulty)
    return Look(median(health.level_dbfs), len(clipped), faulty, picture)


def name_faulty(faulty: tuple[tuple[int, str], ...] | list[tuple[int, str]]) -> str:
    """``microphones 3 stuck, 7 weak``; more than four are counted."""
    if len(faulty) > 4:
        return f"{len(faulty)} microphones faulty"
    named = ", ".join(f"{row} {state}" for row, state in faulty)
    return f"microphone{'s' * (len(faulty) > 1)} {named}"

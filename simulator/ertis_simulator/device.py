"""A scene as a device: directly (``sim:``), or as what a firmware emulator plays."""

from __future__ import annotations

import json
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import DAC_IDLE_CODE
from ertis_driver.closing import Closing
from ertis_driver.device import DeviceInfo, Settings
from ertis_driver.emulator import PingRequest
from ertis_driver.errors import DeviceUnsupported, NotConfigured
from ertis_driver.frame import AUDIO_RATE_HZ, PDM_RATE_HZ, PdmFrame
from ertis_simulator.errors import SceneError
from ertis_simulator.scene import Scene
from ertis_simulator.scene_file import load_scene

_WORKERS = 2  # a core each
_LOOK_AHEAD = 4  # pings ready or computed while one is used: a busy core delays none of them


class SimulatedSonar(Closing):
    """A sonar in a scene. Pings as fast as they can be computed, never faster than a real one.

    What the next pings will sound like is known beforehand, so they are computed on other cores in
    the meantime; the frames are the same ones.
    """

    is_live = False

    def __init__(self, scene: Scene, address: str = "sim:") -> None:
        self._scene = scene
        self._settings: Settings | None = None
        self._index = 0
        self._ready_at = 0.0
        self._pool: ThreadPoolExecutor | None = None
        self._coming: dict[tuple[int, bool], Future[npt.NDArray[np.uint32]]] = {}
        self.info = DeviceInfo(address, "sim")

    @property
    def settings(self) -> Settings | None:
        """What it is configured to do; None before ``configure``."""
        return self._settings

    def configure(self, settings: Settings) -> None:
        """Take the settings.

        Raises
        ------
        DeviceUnsupported
            For an external trigger, the audible clock, or several emissions: not simulated.
        """
        self._settings = None
        self._forget()
        asked = {
            "external_trigger": settings.external_trigger is not None,
            "pdm_rate_hz": settings.pdm_rate_hz != PDM_RATE_HZ,
            "emissions": settings.emissions != 1,
        }
        for name, wanted in asked.items():
            if wanted:
                raise DeviceUnsupported(f"scenes have no {name}: leave it at its default")
        if settings.first_ping_index is not None:
            self._index = settings.first_ping_index
        self._settings = settings

    def ping(self, *, active: bool = True) -> PdmFrame:
        """The next ping of the scene.

        Raises
        ------
        NotConfigured
        """
        if self._settings is None:
            raise NotConfigured("simulated sonar: configure it before the first ping")
        listening_s = self._settings.listening_s
        # Counted from when it was due: a sleep that ends late delays one ping, not all after it.
        due = max(self._ready_at, time.monotonic())
        time.sleep(max(due - time.monotonic(), 0.0))
        self._ready_at = due + listening_s
        started_ns = time.time_ns()
        frame = PdmFrame(self._hear(self._settings, active), self._index, started_ns, 0, active)
        self._index += 1
        return frame

    def _hear(self, settings: Settings, active: bool) -> npt.NDArray[np.uint32]:
        chirp = settings.chirp.samples(AUDIO_RATE_HZ) if active else None
        if self._pool is None:
            self._pool = ThreadPoolExecutor(_WORKERS, "scene")
        for index in range(self._index, self._index + 1 + _LOOK_AHEAD):
            if (index, active) not in self._coming:
                self._coming[index, active] = self._pool.submit(
                    self._scene.hear, index, settings.num_words, chirp
                )
        words = self._coming.pop((self._index, active))
        self._coming = {key: coming for key, coming in self._coming.items() if key[1] == active}
        return words.result()

    def _forget(self) -> None:
        for coming in self._coming.values():
            coming.cancel()
        self._coming.clear()

    def wait_frame(self, timeout_s: float) -> PdmFrame:
        """Refuse: a scene has no trigger pin.

        Raises
        ------
        NotConfigured
        """
        raise NotConfigured("simulated sonar: it has no external trigger; ping it")

    def close(self) -> None:
        """Stop computing; may be called twice."""
        self._forget()
        self._settings = None
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None


def open_sim(path: str) -> SimulatedSonar:
    """``sim:SCENE.yaml``.

    Raises
    ------
    SceneError
    """
    return SimulatedSonar(load_scene(Path(path)), f"sim:{path}")


class SceneFrames:
    """Frame source of the firmware emulator: emits exactly the DAC codes it was given.

    Parameters
    ----------
    scene : Scene
    truth_path : Path or None
        Gets one JSON line a ping: what was there.
    """

    def __init__(self, scene: Scene, truth_path: Path | None = None) -> None:
        self._scene = scene
        self._truth_path = truth_path

    def next_frame(self, request: PingRequest) -> npt.NDArray[np.uint32]:
        """Words of one ping.

        Raises
        ------
        SceneError
            At another PDM clock than the ultrasound one.
        """
        if request.pdm_rate_hz != PDM_RATE_HZ:
            raise SceneError(
                f"PDM clock {request.pdm_rate_hz} Hz, expected {PDM_RATE_HZ}: scenes are simulated "
                "in ultrasound only"
            )
        chirp = played(request.dac_codes, request.dac_rate_hz) if request.active else None
        words = self._scene.hear(request.index, request.num_words, chirp)
        if self._truth_path is not None:
            with self._truth_path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(self._scene.truth(request.index)) + "\n")
        return words


def played(codes: npt.NDArray[np.uint16], rate_hz: int) -> npt.NDArray[np.float64]:
    """What DAC codes sound like, in [-1, 1] at 450 kHz."""
    samples = (codes.astype(np.float64) - DAC_IDLE_CODE) / 2047
    if rate_hz == AUDIO_RATE_HZ:
        return np.asarray(samples)
    times = np.arange(int(codes.size * AUDIO_RATE_HZ / rate_hz)) / AUDIO_RATE_HZ
    return np.interp(times, np.arange(codes.size) / rate_hz, samples)


def scene_frame_source(path: Path, truth_path: Path | None = None) -> SceneFrames:
    """Frame source of a scene file.

    Raises
    ------
    SceneError
    """
    return SceneFrames(load_scene(path), truth_path)

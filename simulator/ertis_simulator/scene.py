"""A scene: what stands where, how the sonar moves, and what it would hear."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from ertis_detector.air import Air
from ertis_driver.frame import DECIMATION, NUM_MICS
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.band import Band
from ertis_simulator.clutter import Clutter
from ertis_simulator.echoes import Echoes
from ertis_simulator.microphone import (
    MicrophoneSet,
    add_noise_spectrum,
    corrupt_half_words,
    kill_microphones,
    to_pdm,
)
from ertis_simulator.noise_sources import NoiseSource, add_sources
from ertis_simulator.objects import DishObject, Thing, stand_for
from ertis_simulator.path import Path, Pose, to_and_fro
from ertis_simulator.propagation import add_echoes, add_trains, render
from ertis_simulator.room import Room
from ertis_simulator.sensor_response import SensorResponse, shipped_response
from ertis_simulator.transducer import direct_path
from ertis_simulator.truth import fragment_span, own_to_rest_db, seen_dish, seen_thing
from ertis_simulator.ways import Shadows, dish_ways

__all__ = ["DishObject", "Pose", "Scene"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A world with one sonar in it.

    Motion during a ping is ignored: at 1 m/s the sonar moves 3.6 cm while it listens.

    things : tuple of Thing
        Named objects other than dishes; those with a footprint shadow the dishes behind them.
        Only dishes are shadowed: walls and clutter shine through.
    stands : bool
        Landmarks stand on rods.
    velocity_m_s, yaw_rate_rad_s
        Of the sonar; ping ``n`` is heard ``n * ping_period_s`` after the start. Before a wall it
        rolls back, its heading as before.
    path : Path or None
        Of the sonar, in place of start, velocity and turn; its height is that of the start.
    dead_mics : microphones whose bit is stuck
    seed : int
        Of all that is random: noise, ring-down, microphones.
    sensor : SensorResponse
        Of transducer and microphones; the shipped one unless a calibration is given.
    """

    room: Room
    start: Pose
    dishes: tuple[DishObject, ...] = ()
    clutter: Clutter = field(default_factory=Clutter.none)
    air: Air = field(default_factory=Air)
    velocity_m_s: tuple[float, float] = (0.0, 0.0)
    yaw_rate_rad_s: float = 0.0
    ping_period_s: float = 0.2
    seed: int = 0
    name: str = "scene"
    things: tuple[Thing, ...] = ()
    stands: bool = False
    path: Path | None = None
    noise: tuple[NoiseSource, ...] = ()
    dead_mics: tuple[int, ...] = ()
    sensor: SensorResponse = field(default_factory=shipped_response)

    def pose(self, ping_index: int) -> Pose:
        """Where the sonar is at one ping."""
        t = ping_index * self.ping_period_s
        x, y, z = self.start.position_m
        if self.path is not None:
            along_x, along_y, yaw = self.path.at(t)
            return Pose((along_x, along_y, z), yaw)
        return Pose(
            (
                to_and_fro(x, self.velocity_m_s[0] * t, self.room.x_m),
                to_and_fro(y, self.velocity_m_s[1] * t, self.room.y_m),
                z,
            ),
            self.start.yaw_rad + self.yaw_rate_rad_s * t,
        )

    def truth(self, ping_index: int) -> dict[str, Any]:
        """Tell what is there, seen from the sonar at one ping; ranges to the dishes' vertices."""
        pose, time_s = self.pose(ping_index), ping_index * self.ping_period_s
        shadows = Shadows.at(self.things, self.dishes, time_s)
        sonar = np.asarray(pose.position_m)
        told: dict[str, list[dict[str, Any]]] = {"landmarks": [], "decoys": [], "objects": []}
        for item in self.dishes:
            clear = shadows.clear_part(item, sonar)
            line = seen_dish(item, item.vertex_at(time_s), pose, clear)
            told["landmarks" if item.is_landmark else "decoys"].append(line)
        told["objects"] = [
            seen_thing(thing.kind, np.asarray(thing.place_m) + thing.offset_m(time_s), pose)
            for thing in self.things
        ]
        return {
            "ping_index": ping_index,
            "source": "sim",
            "scene": self.name,
            "temperature_c": self.air.temperature_c,
            "humidity_percent": self.air.humidity_percent,
            **told,
        }

    def hear(
        self, ping_index: int, num_words: int, chirp: npt.NDArray[np.float64] | None
    ) -> npt.NDArray[np.uint32]:
        """One ping's PDM words; the same for the same arguments, always.

        Parameters
        ----------
        ping_index : int
        num_words : int
        chirp : float64, shape (n,) at 450 kHz, or None
            None: only listen.
        """
        rng = np.random.default_rng([self.seed, ping_index])
        return self._to_words(self._pressure(ping_index, num_words, chirp, rng), num_words, rng)

    def hear_and_judge(
        self, ping_index: int, num_words: int, chirp: npt.NDArray[np.float64]
    ) -> tuple[npt.NDArray[np.uint32], dict[str, Any]]:
        """Words as from ``hear``, and truth in which each landmark also has ``own_to_rest_db``.

        That is the energy of its direct echo against everything else in its fragment, after
        compression by the chirp: as much work again for each landmark.
        """
        rng = np.random.default_rng([self.seed, ping_index])
        pressure = self._pressure(ping_index, num_words, chirp, rng)
        truth = self.truth(ping_index)
        speed = self.air.speed_of_sound_m_s
        landmarks = [item for item in self.dishes if item.is_landmark]
        for item, line in zip(landmarks, truth["landmarks"], strict=True):
            part = self.own_echoes(item, ping_index)
            line["own_to_rest_db"] = None
            if part is not None:
                fragment = fragment_span(line["range_m"], speed)
                # What comes later is of no use, and the renderer's work grows with the time.
                needed = min(fragment[1] + chirp.size, pressure.shape[1])
                own = render(part, self.air, chirp, needed, self._mics().response, self.sensor)
                line["own_to_rest_db"] = own_to_rest_db(own, pressure[:, :needed], chirp, fragment)
        return self._to_words(pressure, num_words, rng), truth

    def _pressure(
        self,
        ping_index: int,
        num_words: int,
        chirp: npt.NDArray[np.float64] | None,
        rng: np.random.Generator,
    ) -> npt.NDArray[np.float32]:
        """Everything that is heard, added up as spectra."""
        num_samples = -(-num_words // DECIMATION)
        band = Band.of(np.zeros(1) if chirp is None else chirp, num_samples, self.sensor)
        spectrum = np.zeros((NUM_MICS, band.fft_size // 2 + 1), np.complex64)
        add_noise_spectrum(spectrum, band.fft_size, rng)
        yaw, speed = self.pose(ping_index).yaw_rad, self.air.speed_of_sound_m_s
        hearing = (spectrum, band.fft_size, num_samples)
        add_sources(*hearing, self.noise, yaw, mic_positions_m(), speed, rng)
        if chirp is not None:
            train = own_train(self.seed, self.air, band).copy()
            outside = self._outside(ping_index)
            if outside:
                add_echoes(train, Echoes.join(outside), self.air, band)
            add_trains(spectrum, train, self._mics().response, band)
        heard = scipy.fft.irfft(spectrum, band.fft_size, axis=1, overwrite_x=True)
        return np.asarray(heard[:, :num_samples])

    def _mics(self) -> MicrophoneSet:
        return MicrophoneSet.draw(np.random.default_rng([self.seed, 2**32]))

    def _to_words(
        self, pressure: npt.NDArray[np.float32], num_words: int, rng: np.random.Generator
    ) -> npt.NDArray[np.uint32]:
        words = to_pdm(pressure, rng)[:num_words]
        corrupt_half_words(words, self._mics().half_words_per_frame * num_words / 163_840, rng)
        kill_microphones(words, self.dead_mics)
        return words

    def echoes(self, ping_index: int) -> Echoes:
        """Every way from emitter to microphones at one ping."""
        return Echoes.join([own_sound(self.seed, self.air), *self._outside(ping_index)])

    def _outside(self, ping_index: int) -> list[Echoes]:
        """Every way that leads away from the sonar."""
        pose, time_s = self.pose(ping_index), ping_index * self.ping_period_s
        emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
        parts = self.room.echoes(pose.to_sensor, pose.turn, emitter, mics)
        reverberation = self.room.reverberation(
            len(mics), np.random.default_rng([self.seed, ping_index, 2**34])
        )
        parts.extend([reverberation] if reverberation is not None else [])
        parts.extend(self._clutter_at(time_s).echoes(pose, emitter, mics))
        shadows = Shadows.at(self.things, self.dishes, time_s)
        for item in self.dishes:
            parts.extend(self._dish_ways(item, pose, shadows))
        return parts

    def own_echoes(self, item: DishObject, ping_index: int) -> Echoes | None:
        """The direct way to one dish and back; None if something hides all of it."""
        shadows = Shadows.at(self.things, self.dishes, ping_index * self.ping_period_s)
        ways = self._dish_ways(item, self.pose(ping_index), shadows, by_floor=False)
        return ways[0] if ways else None

    def _dish_ways(
        self, item: DishObject, pose: Pose, shadows: Shadows, *, by_floor: bool = True
    ) -> list[Echoes]:
        vertex, clear = (
            item.vertex_at(shadows.time_s),
            shadows.clear_part(item, np.asarray(pose.position_m)),
        )
        emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
        return dish_ways(item, vertex, pose, self.room, emitter, mics, clear, by_floor=by_floor)

    def _clutter_at(self, time_s: float) -> Clutter:
        things = list(self.things)
        if self.stands:
            things.extend(stand_for(item) for item in self.dishes if item.is_landmark)
        moved = [thing.clutter.shifted(thing.offset_m(time_s)) for thing in things]
        return Clutter.join([self.clutter, *moved])


def own_sound(seed: int, air: Air) -> Echoes:
    """What a sonar hears of itself: the direct path and the housing's ringing."""
    emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
    return direct_path(emitter, mics, air.speed_of_sound_m_s, np.random.default_rng([seed, 2**33]))


@lru_cache(maxsize=2)
def own_train(seed: int, air: Air, band: Band) -> npt.NDArray[np.complex64]:
    """``own_sound`` as trains, kept: it is that of every ping, wherever the sonar is."""
    train = np.zeros((NUM_MICS, band.length), np.complex64)
    add_echoes(train, own_sound(seed, air), air, band)
    return train

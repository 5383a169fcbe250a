"""A scene: what stands where, how the sonar moves, and what it would hear."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_driver.frame import DECIMATION, NUM_MICS
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.clutter import Clutter
from ertis_simulator.echoes import Echoes
from ertis_simulator.landmark import Dish, dish_echoes
from ertis_simulator.microphone import MicrophoneSet, add_noise, corrupt_half_words, to_pdm
from ertis_simulator.propagation import render
from ertis_simulator.room import Room
from ertis_simulator.transducer import SensorResponse, direct_path, shipped_response

FloatArray = npt.NDArray[np.float64]
VISIBLE_TILT_RAD = np.deg2rad(35.0)  # beyond it only rim and vertex are left: "limiting angle"
VISIBLE_RANGE_M = 0.6  # nearer, the ring-down covers it
VISIBLE_AZIMUTH_RAD = np.deg2rad(25.0)  # the emitter's beam has its first null at 19 (50 kHz)


@dataclass(frozen=True, slots=True)
class DishObject:
    """A dish standing in the scene.

    label : str
        ``r48`` and so on for a landmark; any other word for a decoy, such as ``bowl``.
    vertex_m : (x, y, z)
        Deepest point of the concave face, world frame.
    facing_rad : (azimuth, elevation)
        Where the opening looks, world frame.
    """

    label: str
    dish: Dish
    vertex_m: tuple[float, float, float]
    facing_rad: tuple[float, float]
    is_landmark: bool = True

    @property
    def axis(self) -> FloatArray:
        """Unit vector out of the opening, shape (3,)."""
        azimuth, elevation = self.facing_rad
        return np.array(
            [
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ]
        )


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the sonar is: position (m, world frame) and heading (rad, + left)."""

    position_m: tuple[float, float, float]
    yaw_rad: float

    def to_sensor(self, points_m: FloatArray) -> FloatArray:
        """World points, shape (..., 3), in the sensor frame."""
        return self.turn(points_m - np.asarray(self.position_m))

    def turn(self, vectors: FloatArray) -> FloatArray:
        """World directions, shape (..., 3), in the sensor frame."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.asarray(vectors @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A world with one sonar in it.

    Motion during a ping is ignored: at 1 m/s the sonar moves 3.6 cm while it listens.

    velocity_m_s, yaw_rate_rad_s
        Of the sonar; ping ``n`` is heard ``n * ping_period_s`` after the start.
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
    sensor: SensorResponse = field(default_factory=shipped_response)

    def pose(self, ping_index: int) -> Pose:
        """Where the sonar is at one ping."""
        t = ping_index * self.ping_period_s
        x, y, z = self.start.position_m
        return Pose(
            (x + self.velocity_m_s[0] * t, y + self.velocity_m_s[1] * t, z),
            self.start.yaw_rad + self.yaw_rate_rad_s * t,
        )

    def truth(self, ping_index: int) -> dict[str, Any]:
        """Tell what is there, seen from the sonar at one ping; ranges to the dishes' vertices."""
        pose = self.pose(ping_index)
        told: dict[str, list[dict[str, Any]]] = {"landmarks": [], "decoys": []}
        for item in self.dishes:
            x, y, z = pose.to_sensor(np.asarray(item.vertex_m))
            distance = float(np.sqrt(x * x + y * y + z * z))
            toward = -np.array([x, y, z]) / distance
            tilt = float(np.arccos(np.clip(pose.turn(item.axis) @ toward, -1, 1)))
            azimuth = float(np.arctan2(y, x))
            visible = bool(
                tilt < VISIBLE_TILT_RAD
                and abs(azimuth) < VISIBLE_AZIMUTH_RAD
                and distance > VISIBLE_RANGE_M
            )
            told["landmarks" if item.is_landmark else "decoys"].append(
                {
                    "label": item.label,
                    "range_m": round(distance, 5),
                    "azimuth_rad": round(azimuth, 5),
                    "elevation_rad": round(float(np.arctan2(z, np.hypot(x, y))), 5),
                    "tilt_rad": round(tilt, 5),
                    "visible": visible,
                }
            )
        return {
            "ping_index": ping_index,
            "source": "sim",
            "scene": self.name,
            "temperature_c": self.air.temperature_c,
            **told,
        }

    def hear(
        self,
        ping_index: int,
        num_words: int,
        chirp: npt.NDArray[np.float64] | None,
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
        mics = MicrophoneSet.draw(np.random.default_rng([self.seed, 2**32]))
        num_samples = -(-num_words // DECIMATION)
        pressure = np.zeros((NUM_MICS, num_samples), np.float32)
        if chirp is not None:
            pressure += render(
                self.echoes(ping_index), self.air, chirp, num_samples, mics.response, self.sensor
            )
        add_noise(pressure, rng)
        words = to_pdm(pressure, rng)[:num_words]
        corrupt_half_words(words, mics.half_words_per_frame * num_words / 163_840, rng)
        return words

    def echoes(self, ping_index: int) -> Echoes:
        """Every way from emitter to microphones at one ping."""
        pose = self.pose(ping_index)
        emitter, mics = np.array(EMITTER_POSITION_M), mic_positions_m()
        rng = np.random.default_rng([self.seed, 2**33])
        parts = [direct_path(emitter, mics, self.air.speed_of_sound_m_s, rng)]
        parts.extend(self.room.echoes(pose.to_sensor, pose.turn, emitter, mics))
        if self.clutter.positions_m.size:
            at = pose.to_sensor(self.clutter.positions_m)
            parts.append(self.clutter.echoes(at, emitter, mics))
        floor_z = -pose.position_m[2]
        for item in self.dishes:
            vertex = pose.to_sensor(np.asarray(item.vertex_m))
            axis = pose.turn(item.axis)
            parts.extend(self._dish_and_floor(item.dish, axis, vertex, emitter, mics, floor_z))
        return Echoes.join(parts)

    def _dish_and_floor(
        self,
        dish: Dish,
        axis: FloatArray,
        vertex: FloatArray,
        emitter: FloatArray,
        mics: FloatArray,
        floor_z: float,
    ) -> list[Echoes]:
        """Hear a dish directly, and by way of the floor there, back, and both."""
        mirror = np.array([1.0, 1.0, -1.0])
        lift = np.array([0.0, 0.0, 2 * floor_z])
        parts = []
        ways = [(emitter, False)]
        hearers = [(mics, False)]
        if self.room.floor_reflection > 0:
            ways.append((emitter * mirror + lift, True))
            hearers.append((mics * mirror + lift, True))
        for source, from_floor in ways:
            leaving = vertex - source
            sin_emission = _sin_off_axis(leaving)
            for heard, to_floor in hearers:
                bounces = from_floor + to_floor
                grazing = abs(leaving[2]) / np.linalg.norm(leaving)
                parts.append(
                    dish_echoes(dish, axis, vertex, source, heard).emitted(
                        sin_emission,
                        factor=self.room.floor_reflection**bounces,
                        roughness_m=bounces * self.room.floor_roughness_m * grazing,
                    )
                )
        return parts


def _sin_off_axis(direction: FloatArray) -> float:
    """Sine of the angle off the emitter's axis (x); 1 for anything backward."""
    if direction[0] <= 0:
        return 1.0
    return float(np.hypot(direction[1], direction[2]) / np.linalg.norm(direction))

"""How fast a dish is, and how near to the surface integral it stands for.

``python tests/bench/dish.py [--poses N]``. Random poses, 0.6 to 5 m, tilt 0 to 60 degrees, emitter
and microphones where they are on the sensor; per microphone the correlation over ka 14 to 62
(48 mm: 16 to 70 kHz) of what the simulator uses with iterated physical optics computed there.
It prints; it never fails.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from ertis_detector.air import Air
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m
from ertis_simulator.echoes import Echoes
from ertis_simulator.landmark import DEPTH_RATIO, RADII_MM, Dish, dish_echoes
from ertis_simulator.physical_optics import CapOptics
from ertis_simulator.propagation import render

EMITTER, MICS = np.array(EMITTER_POSITION_M), mic_positions_m()
IDEAL = np.ones(len(MICS), np.complex64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=30)
    args = parser.parse_args()
    print_speed(args.rounds)
    print_accuracy(args.poses)


def best_ms(work, rounds: int) -> float:
    """Shortest of some rounds, in ms."""
    work()
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3


def print_speed(rounds: int) -> None:
    air, chirp = Air(), DEFAULT_CHIRP.samples(450e3)
    dish, at, axis = Dish.landmark(58), np.array([2.0, 0.1, 0.0]), np.array([-1.0, 0.0, 0.0])

    def heard(count: int) -> None:
        bodies = [dish_echoes(dish, axis, at, EMITTER, MICS) for _ in range(count)]
        silent = Echoes.of(np.full(len(MICS), 1.0), np.zeros(len(MICS)))
        render(Echoes.join([silent, *bodies]), air, chirp, 16_384, IDEAL)

    none, ten = (best_ms(lambda count=count: heard(count), rounds) for count in (0, 10))
    print(f"one dish by one way, {len(MICS)} microphones: {(ten - none) / 10:.2f} ms")
    print(f"rest of the rendering, once a ping: {none:.1f} ms")


def print_accuracy(num_poses: int) -> None:
    rng = np.random.default_rng(5)
    mics = MICS[::4]
    poses = [(pose, *place(rng, (pose + 0.5) / num_poses * 60)) for pose in range(num_poses)]
    ka_of = np.arange(14.0, 62.0, 3.0)
    exact = np.zeros((num_poses, len(mics), len(ka_of)), complex)
    for column, ka in enumerate(ka_of):
        cap = CapOptics(DEPTH_RATIO, ka, points_per_wavelength=6)
        for pose, at, axis, _ in poses:
            a = RADII_MM[pose % 4] / 1000
            centre = at + Dish.landmark(a * 1000).sphere_radius_m * axis
            across = np.cross(axis, [0.0, 0.0, 1.0])
            across /= np.linalg.norm(across)
            frame = np.array([across, np.cross(axis, across), axis])
            source, heard = frame @ (EMITTER - centre) / a, (mics - centre) @ frame.T / a
            exact[pose, :, column] = cap.near_field(source, heard)
    print("tilt (deg)  range (m)  radius  correlation (mean, least)  level (dB)")
    for pose, at, axis, tilt_deg in poses:
        a = RADII_MM[pose % 4] / 1000
        body = dish_echoes(Dish.landmark(a * 1000), axis, at, EMITTER, mics).responses[0].body
        k = ka_of / a
        found = np.conj(body.spectrum(k)) * np.exp(1j * k * body.path_m[:, None]) * a
        match = np.abs(np.sum(found * exact[pose].conj(), axis=1))
        match /= np.linalg.norm(found, axis=1) * np.linalg.norm(exact[pose], axis=1)
        level_db = 20 * np.log10(np.linalg.norm(found) / np.linalg.norm(exact[pose]))
        print(
            f"{tilt_deg:10.0f} {np.linalg.norm(at):10.2f} {RADII_MM[pose % 4]:7d}"
            f" {match.mean():13.3f} {match.min():11.3f} {level_db:12.2f}"
        )


def place(rng: np.random.Generator, tilt_deg: float):
    """Vertex, axis and tilt of a dish somewhere before the sensor."""
    azimuth, elevation, roll = rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.15), rng.uniform(0, 6.28)
    toward = -np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    one = np.cross(toward, [0.0, 0.0, 1.0])
    one /= np.linalg.norm(one)
    tilt, other = np.deg2rad(tilt_deg), np.cross(toward, one)
    axis = np.cos(tilt) * toward + np.sin(tilt) * (np.cos(roll) * one + np.sin(roll) * other)
    return -toward * rng.uniform(0.6, 5.0), axis, tilt_deg


if __name__ == "__main__":
    main()

"""Draw what each landmark returns over tilt, in time and in frequency.

``python docs/plots/dish_echoes.py [--out docs/img]`` writes dish-time.png and dish-frequency.png.
Far field, emitter and microphone together; the sonar looks at the vertex's distance.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
import numpy.typing as npt

from ertis_simulator.landmark import RADII_MM, Dish, dish_echoes

mpl.use("Agg")
import matplotlib.pyplot as plt

C_M_S = 343.4
FAR_M = 500.0
TILTS_DEG = np.arange(0.0, 181.0, 1.0)
FREQUENCIES_HZ = np.arange(15e3, 110e3, 250.0)


def scattering_m(dish: Dish, tilt_deg: float) -> npt.NDArray[np.complex128]:
    """Scattering length over frequency, its phase counted from the sphere's centre."""
    tilt = np.deg2rad(tilt_deg)
    axis = np.array([-np.cos(tilt), np.sin(tilt), 0.0])
    at = np.array([FAR_M, 0.0, 0.0]) - dish.sphere_radius_m * axis
    body = dish_echoes(dish, axis, at, np.zeros(3), np.zeros((1, 3))).responses[0].body
    k = 2 * np.pi * FREQUENCIES_HZ / C_M_S
    late_m = body.path_m[0] - 2 * FAR_M
    return np.asarray(body.spectrum(k)[0] * np.exp(-1j * k * late_m)) * FAR_M**2


def draw_frequency(path: Path, lengths: dict[int, npt.NDArray[np.complex128]]) -> None:
    """Target strength over frequency and tilt."""
    figure, axes = plt.subplots(1, 4, figsize=(13, 4), sharey=True, layout="constrained")
    for axis, (radius_mm, length) in zip(axes, lengths.items(), strict=True):
        level_db = 20 * np.log10(np.abs(length) + 1e-6)
        image = axis.pcolormesh(
            FREQUENCIES_HZ / 1e3, TILTS_DEG, level_db, vmin=-50, vmax=0, rasterized=True
        )
        axis.set(title=f"r{radius_mm}, simulated", xlabel="frequency (kHz)")
    axes[0].set_ylabel("tilt (degrees)")
    figure.colorbar(image, ax=axes, label="target strength (dB re 1 m)")
    figure.savefig(path, dpi=80)
    plt.close(figure)


def draw_time(path: Path, lengths: dict[int, npt.NDArray[np.complex128]]) -> None:
    """Envelope of the echo of a 20-80 kHz pulse, with the ways of the closed form."""
    after_s = np.arange(-1000e-6, 600e-6, 2e-6)
    band = (FREQUENCIES_HZ > 20e3) & (FREQUENCIES_HZ < 80e3)
    taper = np.hanning(band.sum())
    turn = np.exp(2j * np.pi * np.outer(FREQUENCIES_HZ[band], after_s))
    figure, axes = plt.subplots(1, 4, figsize=(13, 4), sharey=True, layout="constrained")
    for axis, (radius_mm, length) in zip(axes, lengths.items(), strict=True):
        sphere_m = Dish.landmark(radius_mm).sphere_radius_m
        from_vertex = np.exp(4j * np.pi * FREQUENCIES_HZ[band] * sphere_m / C_M_S)
        envelope = np.abs((length[:, band] * from_vertex * taper) @ turn) / taper.sum()
        level_db = 20 * np.log10(envelope + 1e-6)
        image = axis.pcolormesh(
            after_s * 1e6, TILTS_DEG, level_db, vmin=-60, vmax=-10, rasterized=True
        )
        for share in (0.0, 2 * np.sqrt(2) - 2, 1.0):
            late_us = share * sphere_m / C_M_S * 1e6
            axis.plot([late_us, late_us], [-6, 0], color="tab:red", clip_on=False)
        axis.set(title=f"r{radius_mm}", xlabel="after the vertex (us)", xlim=(-1000, 500))
    axes[0].set(ylabel="tilt (degrees)", ylim=(0, 180))
    figure.colorbar(image, ax=axes, label="echo (dB re 1 m), 20-80 kHz")
    figure.suptitle(
        "simulated; red ticks: vertex, rings of two and three bounces by closed form", fontsize=9
    )
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main() -> None:
    """Write both pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/img"))
    args = parser.parse_args()
    lengths = {
        radius_mm: np.array([scattering_m(Dish.landmark(radius_mm), t) for t in TILTS_DEG])
        for radius_mm in RADII_MM
    }
    draw_frequency(args.out / "dish-frequency.png", lengths)
    draw_time(args.out / "dish-time.png", lengths)


if __name__ == "__main__":
    main()

"""Draw docs/img/baseline.png: impulse responses of one dish, and sizes confused, by call."""

from pathlib import Path

import matplotlib
import numpy as np
import numpy.typing as npt
import scipy.fft

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from ertis_detector.peak_likelihood import PeakStatistics
from ertis_detector.peaks import FRAGMENT_SAMPLES, PeakPattern
from ertis_driver.chirp import DEFAULT_CHIRP, INCUMBENT_CHIRP, Chirp
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_simulator.landmark import RADII_MM, Dish, dish_echoes

Float = npt.NDArray[np.float64]

OUT = Path(__file__).parent.parent / "img/baseline.png"
CALLS = {
    "180-30 kHz, a bat's": Chirp("linear", 180e3, 30e3, 1e-3),
    "80-20 kHz": DEFAULT_CHIRP,
    "50-25 kHz": INCUMBENT_CHIRP,
}
C_M_S, FAR_M, PINGS, TILT_RAD = 343.2, 200.0, 6, np.deg2rad(30.0)
# The pattern alone must tell: neither range nor level is known well.
STATISTICS = PeakStatistics(range_std_m=0.05, gain_spread_db=10.0)


def echoes(chirp: Chirp, radius_mm: int, late_s: Float, rng: np.random.Generator) -> Float:
    """Fragments with one turned dish, noise 30 dB under it."""
    samples = chirp.samples(AUDIO_RATE_HZ)
    num = FRAGMENT_SAMPLES + samples.size
    size = scipy.fft.next_fast_len(4 * num, real=True)
    frequency_hz = scipy.fft.rfftfreq(size, 1 / AUDIO_RATE_HZ)
    k = 2 * np.pi * frequency_hz / C_M_S
    axis, at = np.array([-np.cos(TILT_RAD), np.sin(TILT_RAD), 0.0]), np.array([FAR_M, 0.0, 0.0])
    dish = dish_echoes(Dish.landmark(radius_mm), axis, at, np.zeros(3), np.zeros((1, 3)))
    body = dish.responses[0].body
    spectrum = body.spectrum(k)[0] * np.exp(-1j * k * (body.path_m[0] - 2 * FAR_M))
    spectrum = spectrum * FAR_M**2 * scipy.fft.rfft(samples, size)
    begin_s = FRAGMENT_SAMPLES / 2 / AUDIO_RATE_HZ + late_s
    turn = np.exp(-2j * np.pi * np.outer(begin_s, frequency_hz))
    heard = scipy.fft.irfft(spectrum * turn, size, axis=1)[:, :num]
    noise = np.sqrt(np.mean(heard**2, axis=1, keepdims=True)) * 10 ** (-30 / 20)
    return heard + noise * rng.normal(size=heard.shape)


def main() -> None:
    """Draw."""
    rng = np.random.default_rng(1)
    figure, axes = plt.subplots(2, 3, figsize=(10, 6.2), layout="constrained")
    for column, (name, chirp) in enumerate(CALLS.items()):
        radii = [radius / 1000 for radius in RADII_MM]
        samples = chirp.samples(AUDIO_RATE_HZ)
        pattern = PeakPattern(radii, samples, chirp.band_hz, statistics=STATISTICS)
        said = np.zeros((4, 4), int)
        for number, radius_mm in enumerate(RADII_MM):
            late_s = rng.normal(0, 2 * 0.03 / C_M_S, PINGS)
            late_s[0] = 0
            heard = echoes(chirp, radius_mm, late_s, rng)
            probabilities = pattern.probabilities(heard, np.ones(PINGS))
            np.add.at(said, (number, probabilities[:, :4].argmax(axis=1)), 1)
            if radius_mm in (58, 70):
                response = np.abs(pattern.impulse_response(heard[:1], np.ones(1))[0])
                time_us = (np.arange(response.size) - FRAGMENT_SAMPLES / 2) / AUDIO_RATE_HZ * 1e6
                level_db = 20 * np.log10(response / response.max())
                axes[0, column].plot(time_us, level_db, lw=1, label=f"{radius_mm} mm")
        axes[0, column].set(xlim=(-150, 400), ylim=(-45, 3), title=name)
        axes[0, column].set_xlabel("after the deepest point's echo (us)")
        axes[1, column].imshow(said, cmap="Blues", vmin=0, vmax=PINGS)
        for row, across in np.ndindex(4, 4):
            colour = "white" if said[row, across] > PINGS / 2 else "black"
            count = said[row, across]
            axes[1, column].text(across, row, count, ha="center", va="center", color=colour)
        axes[1, column].set(xticks=range(4), yticks=range(4), xlabel="said (mm)")
        axes[1, column].set_xticklabels(RADII_MM)
        axes[1, column].set_yticklabels(RADII_MM)
    axes[0, 0].set_ylabel("impulse response (dB)")
    axes[0, 0].legend()
    axes[1, 0].set_ylabel("is (mm)")
    figure.suptitle("Peak pattern on simulated dishes turned 30 degrees, no clutter")
    figure.savefig(OUT, dpi=90)


if __name__ == "__main__":
    main()

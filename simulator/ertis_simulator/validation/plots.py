"""Figures of the validation page; whatever is simulated says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from ertis_detector.air import Air
from ertis_simulator.validation.air_checks import PRINTED_DB_KM, midband_hz
from ertis_simulator.validation.measure import density
from ertis_simulator.validation.pdm_checks import data_sheet_density_db, silence
from ertis_simulator.validation.real_ping import QUIET_WORDS, SHAPE_HZ, STARTS_S, PingFigures
from ertis_simulator.validation.wave_checks import (
    AIR,
    RANGES_M,
    beam_pattern,
    delay_errors_s,
    levels_over_range,
    piston_by_quadrature,
)

FloatArray = npt.NDArray[np.float64]
_REAL, _SIM, _EXACT = "#1a1a1a", "#c8501e", "#2a6fb0"
_STYLE: Any = {
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def _save(figure: Any, path: Path) -> None:
    figure.tight_layout()
    # No version or date in the file: the same figures are the same bytes.
    figure.savefig(path, dpi=110, metadata={"Software": None})


def chain(path: Path) -> None:
    """Absorption, spreading, beam pattern and delays against what they must be."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 7.2))
        axes = figure.subplots(2, 2)
        _absorption(axes[0, 0])
        _spreading(axes[0, 1])
        _beam(axes[1, 0])
        _delays(axes[1, 1])
        _save(figure, path)


def _absorption(axis: Any) -> None:
    frequency_hz = np.geomspace(800, 110e3, 200)
    for number, (celsius, percent) in enumerate([(20, 10), (20, 70), (0, 10), (10, 70), (50, 70)]):
        colour = f"C{number}"
        absorbed = Air(celsius, percent).absorption_db_m(frequency_hz)
        label = f"{celsius} °C, {percent} %"
        axis.loglog(frequency_hz / 1e3, absorbed, color=colour, lw=1.2, label=label)
        printed = [row for row in PRINTED_DB_KM if row[:2] == (celsius, percent)]
        points = [(midband_hz(step) / 1e3, level / 1e3) for _, _, step, level in printed]
        axis.plot(*zip(*points, strict=True), "o", color=colour, ms=6, mfc="none")
    axis.set(
        title="Absorption: simulator (lines), ISO 9613-1 table 1 (circles)",
        xlabel="kHz (the printed table ends at 10)",
        ylabel="dB/m",
    )
    axis.legend()


def _spreading(axis: Any) -> None:
    ranges = np.array(RANGES_M)
    for frequency_hz, marker in ((30e3, "s"), (50e3, "o"), (75e3, "^")):
        axis.semilogx(
            ranges,
            levels_over_range(frequency_hz),
            marker,
            color=_SIM,
            mfc="none",
            ms=7,
            label=f"simulated, {frequency_hz / 1e3:.0f} kHz",
        )
    axis.semilogx(ranges, -40 * np.log10(ranges), color=_EXACT, lw=1.2, label="1/r², exact")
    axis.set(
        title="Point scatterer of 1 m, absorption taken out",
        xlabel="range, m",
        ylabel="dB",
        xticks=ranges,
        xticklabels=[f"{r:g}" for r in ranges],
    )
    axis.minorticks_off()
    axis.legend()


def _beam(axis: Any) -> None:
    degrees = np.arange(0.0, 45.1, 1.0)
    for number, frequency_hz in enumerate((30e3, 50e3, 75e3)):
        wavenumber = 2 * np.pi * frequency_hz / AIR.speed_of_sound_m_s
        fine = np.linspace(0, 45, 400)
        exact = [abs(piston_by_quadrature(wavenumber, s)) for s in np.sin(np.deg2rad(fine))]
        colour = f"C{number}"
        axis.plot(fine, 20 * np.log10(np.maximum(exact, 1e-4)), color=colour, lw=1.2)
        label = f"{frequency_hz / 1e3:.0f} kHz"
        axis.plot(
            degrees, beam_pattern(frequency_hz, degrees), "o", color=colour, ms=3.5, label=label
        )
    axis.set(
        title="Emitter: simulated (dots), disc added up in strips (lines)",
        xlabel="degrees off the axis",
        ylabel="dB re axis",
        ylim=(-50, 2),
    )
    axis.legend()


def _delays(axis: Any) -> None:
    rendered = delay_errors_s(through_pdm=False) * 1e9
    decoded = delay_errors_s(through_pdm=True) * 1e9
    axis.plot(rendered, "o", color=_SIM, mfc="none", label="simulated sound")
    label = f"simulated PDM, decoded, {-decoded.mean():.0f} ns added"
    axis.plot(decoded - decoded.mean(), "x", color=_SIM, label=label)
    axis.axhline(0, color=_EXACT, lw=1)
    axis.set(
        title="Delay of each microphone against geometry",
        xlabel="microphone",
        ylabel="ns (10 ns are 3.4 µm)",
        ylim=(-25, 25),
    )
    axis.legend()


def noise(path: Path, real_words: npt.NDArray[np.uint32]) -> None:
    """Noise of the bits over frequency, real and simulated."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 4.2))
        axes = figure.subplots(1, 2, width_ratios=(1.7, 1))
        for words, colour, label in (
            (real_words[QUIET_WORDS:], _REAL, "real ping, its last 3 ms"),
            (silence(), _SIM, "simulated silence"),
        ):
            frequency_hz, level_db = density(words, 4096)
            part = slice(3, None)
            axes[0].semilogx(
                frequency_hz[part] / 1e3, level_db[part], color=colour, lw=1, label=label
            )
            near = (frequency_hz > 20e3) & (frequency_hz < 130e3)
            axes[1].plot(frequency_hz[near] / 1e3, level_db[near], color=colour, lw=1.2)
        axes[0].plot(
            [3.3, 10],
            [data_sheet_density_db()] * 2,
            color=_EXACT,
            lw=2.5,
            label="data sheet, 64 dB(A)",
        )
        axes[0].set(
            title="Noise of the PDM bits, median of 32 microphones", xlabel="kHz", ylabel="dBFS/Hz"
        )
        axes[0].legend()
        axes[1].set(title="The band that echoes use", xlabel="kHz", ylim=(-117, -97))
        axes[1].text(51, -99.2, "25 to 50 kHz: last\nechoes of the real chirp", fontsize=8)
        _save(figure, path)


def ping(path: Path, real: PingFigures, simulated: PingFigures, num_seeds: int) -> None:
    """Direct path and ring-down, echoes' shape, microphones, runs of bits."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(10, 7.2))
        axes = figure.subplots(2, 2)
        name = f"simulated ({num_seeds} sonars)"
        for one, colour, label in ((real, _REAL, "real ping"), (simulated, _SIM, name)):
            _ring_down(axes[0, 0], one, colour, label)
            shape = one.shapes_db - one.shapes_db[:, [int(np.abs(SHAPE_HZ - 46e3).argmin())]]
            axes[0, 1].plot(SHAPE_HZ / 1e3, shape.mean(axis=0), color=colour, lw=1.8, label=label)
            axes[0, 1].plot(SHAPE_HZ / 1e3, shape.T, color=colour, lw=0.7, alpha=0.6)
        axes[0, 0].set(
            title="Level, 20 to 60 kHz: median, middle 80 % of microphones",
            xlabel="ms after word 0",
            ylabel="dBFS (RMS of 0.25 ms)",
        )
        axes[0, 1].set(
            title="Echoes at 3.20 and 3.74 m (thin), their mean (thick)",
            xlabel="kHz",
            ylabel="dB re 46 kHz, absorption taken out",
        )
        axes[0, 0].annotate(
            "an echo of that room",
            (6.9, -48),
            (5.6, -33),
            fontsize=8,
            arrowprops={"arrowstyle": "-"},
        )
        _microphones(axes[1, 0], real, simulated)
        _runs(axes[1, 1], real, simulated, name)
        for axis in axes.ravel():
            axis.legend()
        _save(figure, path)


def _ring_down(axis: Any, one: PingFigures, colour: str, label: str) -> None:
    time_ms = STARTS_S * 1e3 + 0.125
    low, middle, high = np.percentile(one.levels_dbfs, (10, 50, 90), axis=0)
    axis.fill_between(time_ms, low, high, color=colour, alpha=0.18, lw=0)
    axis.plot(time_ms, middle, color=colour, lw=1.5, label=label)


def _microphones(axis: Any, real: PingFigures, simulated: PingFigures) -> None:
    axis.plot(
        *simulated.gains_db, ".", color=_SIM, ms=3, alpha=0.5, label="simulated, several sonars"
    )
    axis.plot(*real.gains_db, "o", color=_REAL, ms=5, mfc="none", label="real ping, 32 microphones")
    axis.set(
        title="Microphones' levels in the two echoes",
        xlabel="3.20 m: dB re mean",
        ylabel="3.74 m: dB re mean",
        aspect="equal",
        xlim=(-4.5, 4.5),
        ylim=(-4.5, 4.5),
    )


def _runs(axis: Any, real: PingFigures, simulated: PingFigures, name: str) -> None:
    place = np.arange(1, 5)
    axis.bar(place - 0.2, 100 * real.runs, 0.4, color=_REAL, label="real ping")
    axis.bar(place + 0.2, 100 * simulated.runs, 0.4, color=_SIM, label=name)
    axis.set(
        title="Runs of equal bits in silence",
        xlabel="words",
        ylabel="% of all runs",
        yscale="log",
        ylim=(0.01, 150),
        xticks=place,
        xticklabels=["1", "2", "3", "4 or more"],
    )

"""The real ping and its simulated twin, measured the same way, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.direct_path import find_direct_path
from ertis_driver.frame import AUDIO_RATE_HZ
from ertis_driver.geometry import mic_positions_m
from ertis_driver.health import check_ping
from ertis_simulator.validation.measure import (
    density,
    echo_gains,
    echo_shape,
    group_delay,
    in_bands,
    level_over_time,
    likeness,
    run_shares,
)
from ertis_simulator.validation.twin import AIR, ECHOES

FloatArray = npt.NDArray[np.float64]
SHAPE_HZ: FloatArray = np.arange(26e3, 48.1e3, 1e3)
STARTS_S: FloatArray = np.arange(0.1e-3, 7.0e-3, 0.1e-3)
NOISE_HZ: FloatArray = np.array(
    [9e3, 15e3, 60e3, 75e3, 90e3, 105e3, 120e3, 150e3, 200e3, 250e3, 400e3, 700e3, 1e6, 2e6]
)
QUIET_WORDS = 150_300  # from 33.4 ms on: the quietest stretch of the real ping
_REFERENCE_HZ = 46e3
_EARLY_HZ, _LATE_HZ = (36e3, 42e3), (46e3, 50e3)  # the transducer rings at 50 kHz


@dataclass(frozen=True, slots=True, eq=False)
class PingFigures:
    """All that is compared of one ping.

    levels_dbfs : shape (num_mics, len(STARTS_S)), 20 to 60 kHz in 0.25 ms from each of ``STARTS_S``
    noise_db : shape (len(NOISE_HZ),), dBFS/Hz of the bits from ``QUIET_WORDS`` on
    shapes_db : shape (2, len(SHAPE_HZ)), of the two strong echoes, without absorption
    gains_db, phases_deg : shape (2, num_mics), of each microphone in these echoes
    lags_s : shape (2,), by how much they come later from 46 to 50 kHz than from 36 to 42
    runs : shape (4,), share of runs of 1, 2, 3 and more equal bits from ``QUIET_WORDS`` on
    """

    levels_dbfs: FloatArray
    noise_db: FloatArray
    tail_dbfs: float
    shapes_db: FloatArray
    gains_db: FloatArray
    phases_deg: FloatArray
    lags_s: FloatArray
    runs: FloatArray
    peaks: FloatArray
    saturated: float
    saturated_s: float
    half_words: float
    delay_s: float
    likeness: float


def figures(words: npt.NDArray[np.uint32]) -> PingFigures:
    """Measure one default frame of the incumbent's chirp."""
    decoded = PdmDecoder().decode(words)
    audio, health = decoded.audio, check_ping(words, decoded)
    chirp = INCUMBENT_CHIRP.samples(AUDIO_RATE_HZ)
    paths = [echo.path_m() for echo in ECHOES]
    frequency_hz, level_db = density(words[QUIET_WORDS:], 4096)
    each = [echo_gains(audio, chirp, path, AIR, mic_positions_m()) for path in paths]
    return PingFigures(
        levels_dbfs=level_over_time(audio, STARTS_S),
        noise_db=in_bands(frequency_hz, level_db, NOISE_HZ),
        tail_dbfs=float(health.usual_noise_dbfs or np.nan),
        shapes_db=np.array([echo_shape(audio, chirp, path, AIR, SHAPE_HZ) for path in paths]),
        gains_db=np.array([gain for gain, _ in each]),
        phases_deg=np.array([phase for _, phase in each]),
        lags_s=np.array([_lag_s(audio, chirp, path) for path in paths]),
        runs=run_shares(words[QUIET_WORDS:]),
        peaks=np.abs(audio[:, 30:1500]).max(axis=1).astype(np.float64),
        saturated=float(len(health.saturated)),
        saturated_s=float(sum(health.saturated_s)),
        half_words=float(decoded.half_words_repaired),
        delay_s=find_direct_path(audio, INCUMBENT_CHIRP).delay_s,
        likeness=likeness(audio, 58e3, 105e3),
    )


def _lag_s(audio: npt.NDArray[np.float32], chirp: FloatArray, path_m: FloatArray) -> float:
    late, early = (group_delay(audio, chirp, path_m, AIR, band) for band in (_LATE_HZ, _EARLY_HZ))
    return late - early


def pooled(each: Sequence[PingFigures]) -> PingFigures:
    """Several pings as one: microphones side by side, everything else averaged."""
    side_by_side = {"levels_dbfs": 0, "peaks": 0, "gains_db": 1, "phases_deg": 1}
    values: dict[str, Any] = {}
    for name in (field.name for field in fields(PingFigures)):
        parts = [getattr(one, name) for one in each]
        if name in side_by_side:
            values[name] = np.concatenate(parts, axis=side_by_side[name])
        else:
            values[name] = np.mean(parts, axis=0)
    return PingFigures(**values)


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the comparison; a test holds it to ``allowed``, None if it is told only."""

    what: str
    real: float
    simulated: float
    unit: str
    allowed: float | None = None

    @property
    def difference(self) -> float:
        """Simulated minus real."""
        return self.simulated - self.real


def compare(real: PingFigures, simulated: PingFigures) -> list[Row]:
    """The table."""

    def row(
        what: str, figure: Callable[[PingFigures], Any], unit: str, allowed: float | None = None
    ) -> Row:
        return Row(what, float(figure(real)), float(figure(simulated)), unit, allowed)

    rows = []
    for start_ms in (0.3, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0):
        kind = "direct path" if start_ms < 2.6 else "ring-down"
        name = f"{kind}, level at {start_ms} ms, median"
        rows.append(row(name, partial(_median_level, start_s=start_ms * 1e-3), "dBFS", 4.5))
    rows += [
        row("ring-down from 3 to 5 ms", _slope_db_ms, "dB/ms", 2.0),
        row("spread of the level at 0.3 ms over microphones", _spread_of_level, "dB", 1.5),
        row(
            "peak of the direct path, median",
            _peak,
            "of full scale",
            0.2,
        ),
        row("saturated microphones", lambda one: one.saturated, "", 5.0),
        row("saturated, all together", lambda one: one.saturated_s * 1e6, "us"),
        row("delay of the direct path", lambda one: one.delay_s * 1e6, "us", 50.0),
    ]
    for centre_hz in (28e3, 32e3, 36e3, 40e3, 44e3, 48e3):
        name = f"strong echoes at {centre_hz / 1e3:.0f} kHz against 46 kHz"
        rows.append(row(name, partial(_shape_at, centre_hz=centre_hz), "dB", 3.0))
    lag = "strong echoes at 46 to 50 kHz, later than at 36 to 42 kHz"
    rows.append(row(lag, lambda one: one.lags_s.mean() * 1e6, "us"))
    for index, centre_hz in enumerate(NOISE_HZ):
        name = f"noise at {centre_hz / 1e3:g} kHz"
        rows.append(row(name, partial(_noise, index=index), "dBFS/Hz", 4.0))
    rows += [
        row("noise from 20 to 80 kHz", lambda one: one.tail_dbfs, "dBFS", 2.0),
        row("spread of gains, common to both echoes", lambda one: _common(one.gains_db), "dB", 0.5),
        row("spread of phases, likewise", lambda one: _common(one.phases_deg), "degrees", 2.5),
        row("spread of levels in one echo", lambda one: one.gains_db.std(axis=1).mean(), "dB"),
    ]
    for index, name in enumerate(("1 bit", "2 equal bits", "3 equal bits", "4 or more")):
        share = f"runs of {name} in silence"
        rows.append(row(share, partial(_share, index=index), "%", 8.0))
    rows += [
        row("half-words mended", lambda one: one.half_words, "a frame", 4.0),
        row("microphones' likeness in the quiet, 58 to 105 kHz", lambda one: one.likeness, "of 32"),
    ]
    return rows


def _column(start_s: float) -> int:
    return int(np.abs(STARTS_S - start_s).argmin())


def _median_level(one: PingFigures, start_s: float) -> float:
    return float(np.median(one.levels_dbfs[:, _column(start_s)]))


def _spread_of_level(one: PingFigures) -> float:
    return float(one.levels_dbfs[:, _column(0.3e-3)].std())


def _peak(one: PingFigures) -> float:
    return float(np.median(one.peaks))


def _noise(one: PingFigures, index: int) -> float:
    return float(one.noise_db[index])


def _share(one: PingFigures, index: int) -> float:
    return 100 * float(one.runs[index])


def _slope_db_ms(one: PingFigures) -> float:
    inside = (STARTS_S > 2.95e-3) & (STARTS_S < 5.05e-3)
    level = np.median(one.levels_dbfs[:, inside], axis=0)
    return float(np.polyfit(STARTS_S[inside] * 1e3, level, 1)[0])


def _shape_at(one: PingFigures, centre_hz: float) -> float:
    mean = one.shapes_db.mean(axis=0)
    column, reference = (int(np.abs(SHAPE_HZ - f).argmin()) for f in (centre_hz, _REFERENCE_HZ))
    return float(mean[column] - mean[reference])


def _common(values: FloatArray) -> float:
    """Standard deviation over microphones of what two echoes have in common, (2, n) values."""
    return float(np.sqrt(max(np.cov(values)[0, 1], 0.0)))

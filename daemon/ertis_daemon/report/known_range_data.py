"""A labelled data set as the strict protocol takes it: each ping with the range its label says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_detector.air import Air
from ertis_detector.method import KnownRangePing, Method
from ertis_detector.protocol import Labels
from ertis_driver.audio import PdmDecoder, whole_samples
from ertis_driver.dataset import Dataset, DatasetRow
from ertis_driver.errors import DatasetError
from ertis_driver.frame import AUDIO_RATE_HZ, PDM_RATE_HZ
from ertis_driver.geometry import EMITTER_POSITION_M, mic_positions_m


@dataclass(frozen=True, slots=True)
class Prepared:
    """What methods need of one ping, and who made it."""

    arrays: tuple[npt.NDArray[Any], ...]
    source: str
    chirp: str


@dataclass(frozen=True)
class Preparer:
    """Reads pings, decodes them, and keeps only what methods need of them."""

    dataset: Dataset
    methods: Sequence[Method]

    def __call__(self, row: DatasetRow) -> Prepared:
        """What each method needs of one ping.

        Raises
        ------
        RecordingError, DatasetError, DetectorError
        """
        ping, source, chirp = self.read(row)
        return Prepared(tuple(method.prepare(ping) for method in self.methods), source, chirp)

    def read(self, row: DatasetRow) -> tuple[KnownRangePing, str, str]:
        """One ping, who made it, and its chirp's name.

        Raises
        ------
        RecordingError, DatasetError
        """
        info, ping = self.dataset.read(row)
        path = self.dataset.path(row)
        if info.chirp is None:
            raise DatasetError(f"{path} says no chirp, expected one: record it with its chirp")
        if info.pdm_rate_hz != PDM_RATE_HZ:
            raise DatasetError(
                f"{path}: PDM clock {info.pdm_rate_hz} Hz, expected {PDM_RATE_HZ}: the protocol "
                "is for 450 kHz audio"
            )
        known = KnownRangePing(
            audio=self._decoder.decode(whole_samples(ping.frame.words)).audio,
            range_m=row.range_m,
            azimuth_rad=row.azimuth_rad,
            air=Air.measured(ping.temperature_c, ping.humidity_percent),
            chirp=info.chirp.samples(AUDIO_RATE_HZ),
            chirp_band_hz=info.chirp.band_hz,
            chirp_name=info.chirp.name,
            mic_positions_m=mic_positions_m(),
            emitter_position_m=np.array(EMITTER_POSITION_M),
        )
        return known, info.source, info.chirp.name

    @cached_property
    def _decoder(self) -> PdmDecoder:
        return PdmDecoder()

    def __getstate__(self) -> dict[str, Any]:
        return {"dataset": self.dataset, "methods": self.methods}


def usable_rows(dataset: Dataset) -> list[DatasetRow]:
    """Rows whose range is known, in the table's order.

    Raises
    ------
    DatasetError
        If there is none.
    """
    rows = [row for row in dataset.rows if not np.isnan(row.range_m)]
    if not rows:
        raise DatasetError(
            f"{dataset.folder}: no ping with a range in its label: the protocol is told the range"
        )
    return rows


def labels_of(rows: Sequence[DatasetRow]) -> Labels:
    """Labels, environments and sessions of rows.

    Raises
    ------
    EvaluationError
        If the labels are too few.
    """
    return Labels(
        tuple(row.label for row in rows),
        tuple(row.environment for row in rows),
        tuple(f"{row.environment}/{row.session}" for row in rows),
    )

"""What a recording says about itself, and one ping of it."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np

from ertis_driver.chirp import Chirp, Emission
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.device import MAX_NUM_WORDS, PDM_RATES_HZ
from ertis_driver.errors import SettingsError
from ertis_driver.frame import NUM_MICS, PDM_RATE_HZ, PdmFrame, Source
from ertis_driver.geometry import mic_positions_m

FORMAT_VERSION = "1"  # raised when an older reader would misunderstand a newer recording
CREATED_BY = "ertis"
METADATA = "ertis"  # name of the table in the file
METADATA_COPY = "ertis.copy"  # the same once more: one damaged bit shall not cost it
MAX_TEXT_CHARS = 2000  # of each free text

Position = tuple[float, float, float]
_TEXTS = (
    "operator",
    "place",
    "note",
    "licence",
    "started",
    "amplifier",
    "external_trigger",
    "label",
)


@dataclass(frozen=True, slots=True)
class RecordingInfo:
    """Who made a recording, and how.

    source : str
        ``live``, ``sim`` or ``replay``: who made the frames.
    chirp : Chirp, CustomChirp or None
        What was emitted; None if that is not known.
    num_words : int
        PDM words of each ping.
    temperature_c : float or None
        Air temperature, degrees Celsius; None if that is not known.
    humidity_percent : float or None
        Relative humidity of the air; None if that is not known.
    firmware : str
        ``major.minor.bugfix``, or empty.
    address : str
        The device as its user called it, or empty.
    pdm_rate_hz : int
        Words a second of each ping.
    operator, place, note, licence : str
        Who recorded, where, what for, and what others may do with it.
    started : str
        When, ISO 8601 with the offset from UTC, on the host's clock; or empty.
    emissions : int
        How often the chirp is emitted in one ping.
    amplifier, external_trigger : str
        As the device was asked: ``on``, ``off`` or empty; ``pin 1 active`` or the like, or empty.
    label : str
        Of a labelled data set's ping, as it was recorded, JSON; its table is what holds.
    part : int
        Number of this file in a recording that was split, from 1; 0 for a whole one.
    mic_positions_m : tuple of (x, y, z)
        Of the microphones by row, sensor frame, m.

    Raises
    ------
    SettingsError
        If a text is too long.
    """

    source: Source
    chirp: Emission | None
    num_words: int
    temperature_c: float | None = None
    humidity_percent: float | None = None
    firmware: str = ""
    address: str = ""
    pdm_rate_hz: int = PDM_RATE_HZ
    operator: str = ""
    place: str = ""
    note: str = ""
    licence: str = ""
    started: str = ""
    emissions: int = 1
    amplifier: str = ""
    external_trigger: str = ""
    label: str = ""
    part: int = 0
    mic_positions_m: tuple[Position, ...] = field(default_factory=lambda: _layout())

    def __post_init__(self) -> None:
        for name in _TEXTS:
            if len(getattr(self, name)) > MAX_TEXT_CHARS:
                raise SettingsError(
                    f"{name} of {len(getattr(self, name))} characters, expected at most "
                    f"{MAX_TEXT_CHARS}: put it into a file beside the recording"
                )


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPing:
    """One ping of a recording.

    frame : PdmFrame
        As it was recorded.
    truth : dict or None
        What stood where, if that is known.
    temperature_c : float or None
        Air temperature at this ping, degrees Celsius, if it was measured.
    humidity_percent : float or None
        Relative humidity of the air at this ping, if it was measured.
    """

    frame: PdmFrame
    truth: dict[str, Any] | None = None
    temperature_c: float | None = None
    humidity_percent: float | None = None


def to_strings(info: RecordingInfo) -> dict[str, str]:
    """As MCAP metadata: strings only, and empty for what is not known."""
    chirp = info.chirp
    table = {
        "format_version": FORMAT_VERSION,
        "created_by": CREATED_BY,
        "source": info.source,
        **_chirp_strings(chirp),
        "dac_rate_hz": "" if chirp is None else str(chirp.dac_rate_hz),
        "num_words": str(info.num_words),
        "pdm_rate_hz": str(info.pdm_rate_hz),
        "temperature_c": _number(info.temperature_c),
        "humidity_percent": _number(info.humidity_percent),
        "firmware": info.firmware,
        "device": info.address,
        **{name: getattr(info, name) for name in _TEXTS},
        "emissions": str(info.emissions),
        "part": str(info.part),
        "mic_positions_m": json.dumps(info.mic_positions_m),
    }
    # MCAP has no checksum here but that of the whole file, which is known only at its end.
    return table | {"crc32": _checksum(table)}


def from_strings(table: Mapping[str, str]) -> RecordingInfo:
    """Read what ``to_strings`` wrote; who wrote less, said nothing about the rest.

    Raises
    ------
    ValueError
        If it is of another version, damaged or incomplete; one line that says which.
    """
    if table.get("format_version") != FORMAT_VERSION:
        raise ValueError(
            f"format version {table.get('format_version')!r}, expected {FORMAT_VERSION!r}"
        )
    rest = {key: value for key, value in table.items() if key != "crc32"}
    if table.get("crc32") != _checksum(rest):
        raise ValueError("checksum of the metadata is wrong")
    try:
        source = table["source"]
        if source not in get_args(Source):
            raise ValueError(f"source {source!r}, expected one of {', '.join(get_args(Source))}")
        if table["pdm_rate_hz"] not in map(str, PDM_RATES_HZ):
            raise ValueError(f"PDM rate {table['pdm_rate_hz']} Hz, expected one of {PDM_RATES_HZ}")
        num_words = int(table["num_words"])
        if not 0 < num_words <= MAX_NUM_WORDS:
            raise ValueError(f"{num_words} words a ping, expected 1 to {MAX_NUM_WORDS}")
        return RecordingInfo(
            source=source,  # type: ignore[arg-type]  # one of the three, as checked above
            chirp=_chirp(table),
            num_words=num_words,
            temperature_c=_known(table["temperature_c"]),
            humidity_percent=_known(table.get("humidity_percent", "")),
            firmware=table["firmware"],
            address=table["device"],
            pdm_rate_hz=int(table["pdm_rate_hz"]),
            **{name: table.get(name, "")[:MAX_TEXT_CHARS] for name in _TEXTS},
            emissions=int(table.get("emissions", 1)),
            part=int(table.get("part", 0)),
            mic_positions_m=_positions(table.get("mic_positions_m", json.dumps(_layout()))),
        )
    except KeyError as error:
        raise ValueError(f"metadata without {error}") from error


def _number(value: float | None) -> str:
    return "" if value is None else repr(float(value))


def _known(text: str) -> float | None:
    return float(text) if text else None


def _layout() -> tuple[Position, ...]:
    return tuple((x, y, z) for x, y, z in mic_positions_m().tolist())


def _positions(text: str) -> tuple[Position, ...]:
    try:
        rows = tuple((float(x), float(y), float(z)) for x, y, z in json.loads(text))
    except (TypeError, RecursionError) as error:
        raise ValueError("microphone positions that are none") from error
    if len(rows) != NUM_MICS or not all(math.isfinite(value) for row in rows for value in row):
        raise ValueError(f"positions of {len(rows)} microphones, expected {NUM_MICS}")
    return rows


def _chirp_strings(chirp: Emission | None) -> dict[str, str]:
    if isinstance(chirp, Chirp):
        # Chirp.name rounds to six digits, which a recording must not.
        values = (chirp.f_start_hz, chirp.f_stop_hz, chirp.duration_s)
        text = ":".join([chirp.kind, *(repr(float(value)) for value in values)])
        return {"chirp": text, "chirp_ramp": repr(chirp.ramp)}
    if chirp is None:
        return {"chirp": "", "chirp_ramp": ""}
    codes = base64.b64encode(chirp.dac_codes().astype("<u2").tobytes()).decode()
    return {"chirp": chirp.name, "chirp_ramp": "", "chirp_dac_codes": codes}


def _chirp(table: Mapping[str, str]) -> Emission | None:
    if not table["chirp"]:
        return None
    try:
        if "chirp_dac_codes" in table:
            codes = np.frombuffer(base64.b64decode(table["chirp_dac_codes"]), "<u2")
            return CustomChirp(tuple(codes.tolist()), int(table["dac_rate_hz"]))
        kind, start, stop, duration = table["chirp"].split(":")
        return Chirp(
            kind,  # type: ignore[arg-type]  # Chirp checks it
            float(start),
            float(stop),
            float(duration),
            float(table["chirp_ramp"]),
            int(table["dac_rate_hz"]),
        )
    except SettingsError as error:
        raise ValueError(str(error)) from error


def _checksum(table: Mapping[str, str]) -> str:
    text = "\n".join(f"{key}={table[key]}" for key in sorted(table))
    return f"{zlib.crc32(text.encode()):08x}"

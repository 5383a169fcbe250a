"""What a recording says about itself, and one ping of it."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from ertis_driver.chirp import Chirp, Emission
from ertis_driver.custom_chirp import CustomChirp
from ertis_driver.device import PDM_RATES_HZ
from ertis_driver.errors import SettingsError
from ertis_driver.frame import PDM_RATE_HZ, PdmFrame, Source

FORMAT_VERSION = "1"
CREATED_BY = "ertis"


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
    firmware : str
        ``major.minor.bugfix``, or empty.
    address : str
        The device as its user called it, or empty.
    pdm_rate_hz : int
        Words a second of each ping.
    """

    source: Source
    chirp: Emission | None
    num_words: int
    temperature_c: float | None = None
    firmware: str = ""
    address: str = ""
    pdm_rate_hz: int = PDM_RATE_HZ


@dataclass(frozen=True, slots=True, eq=False)
class RecordedPing:
    """One ping of a recording.

    frame : PdmFrame
        As it was recorded.
    truth : dict or None
        What stood where, if that is known.
    temperature_c : float or None
        Air temperature at this ping, degrees Celsius, if it was measured.
    """

    frame: PdmFrame
    truth: dict[str, Any] | None = None
    temperature_c: float | None = None


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
        "temperature_c": "" if info.temperature_c is None else repr(float(info.temperature_c)),
        "firmware": info.firmware,
        "device": info.address,
    }
    # MCAP has no checksum here but that of the whole file, which is known only at its end.
    return table | {"crc32": _checksum(table)}


def from_strings(table: Mapping[str, str]) -> RecordingInfo:
    """Read what ``to_strings`` wrote.

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
        return RecordingInfo(
            source=source,  # type: ignore[arg-type]  # one of the three, as checked above
            chirp=_chirp(table),
            num_words=int(table["num_words"]),
            temperature_c=float(table["temperature_c"]) if table["temperature_c"] else None,
            firmware=table["firmware"],
            address=table["device"],
            pdm_rate_hz=int(table["pdm_rate_hz"]),
        )
    except KeyError as error:
        raise ValueError(f"metadata without {error}") from error


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

"""What is published: one event for a ping with landmarks, and its JSON Schema. See EVENTS.md."""

# ruff: noqa: RUF009  # _item() is dataclasses.field() with metadata of ours
from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal, get_args, get_origin, get_type_hints

SCHEMA = "ertis.landmarks/1"
ENCODING = f"application/json;{SCHEMA}"

TrackState = Literal["new", "update", "lost"]
Row = tuple[float, float, float]
Covariance = tuple[Row, Row, Row]


def _item(doc: str, unit: str = "", **limits: Any) -> Any:
    key = limits.pop("key", None)
    default = limits.pop("default", dataclasses.MISSING)
    meta = {"doc": doc, "unit": unit, "limits": limits, "key": key}
    return field(default=default, metadata=meta)


@dataclass(frozen=True, slots=True)
class LandmarkReport:
    """One landmark of an event. A number that could not be determined is NaN; null in JSON."""

    track_id: int = _item("the same number as long as this landmark is followed", minimum=0)
    state: TrackState = _item(
        "new in this ping, heard again, or given up; a lost one repeats its last report"
    )
    label: str = _item("most probable size: r and the aperture radius in mm", key="class")
    probabilities: Mapping[str, float] = _item(
        "of every class, 'none' and 'unknown' included; they sum to 1", minimum=0, maximum=1
    )
    range_m: float = _item("from the centre of the array to the dish's vertex", "m", minimum=0)
    azimuth_rad: float = _item("left is positive", "rad", minimum=-math.pi, maximum=math.pi)
    elevation_rad: float = _item("up is positive", "rad", minimum=-math.pi / 2, maximum=math.pi / 2)
    covariance: Covariance = _item("of (range, azimuth, elevation), 3 rows of 3", "m2, m rad, rad2")
    snr_db: float = _item("peak of the echo over its noise floor", "dB")
    radius_m: float | None = _item("aperture radius of the class; null for unknown", "m", minimum=0)
    tilt_rad: float = _item(
        "angle between the dish's axis and the line of sight; null where the echo does not tell",
        "rad",
        minimum=0,
        maximum=math.pi,
        default=math.nan,
    )


@dataclass(frozen=True, slots=True)
class LandmarkEvent:
    """The landmarks of one ping."""

    schema: str = _item("name and version of this format", const=SCHEMA)
    device: str = _item("the sonar's name, as in the key", minLength=1)
    ping_index: int = _item("the device's counter", minimum=0, maximum=2**32 - 1)
    ping_time_ns: int = _item("when the ping was triggered, UNIX epoch", "ns", minimum=0)
    time_uncertainty_ns: int = _item("half-width of the interval around it", "ns", minimum=0)
    frame_id: str = _item("coordinate frame: x forward, y left, z up", minLength=1)
    source: Literal["live", "replay", "sim"] = _item("who made the echo")
    model: str = _item("name of the classifier's model")
    landmarks: tuple[LandmarkReport, ...] = _item("what was heard or lost, never empty", minItems=1)
    speed_of_sound_m_s: float = _item("used for the ranges", "m/s", minimum=0)
    temperature_c: float = _item("of the air, as configured", "degrees Celsius", minimum=-273.15)

    def to_json(self) -> bytes:
        """Return one line of JSON, UTF-8; NaN and infinities become null."""
        return dump_json(self)


def dump_json(value: Any) -> bytes:
    """Compact JSON in UTF-8, numbers that JSON does not have as null."""
    try:
        return _dump(value).encode()
    except ValueError:  # a NaN or an infinity is somewhere in it
        return _dump(_plain(value)).encode()


_dump = json.JSONEncoder(
    separators=(",", ":"), allow_nan=False, ensure_ascii=False, default=lambda value: _items(value)
).encode


def _plain(value: Any) -> Any:
    """The same, made of dicts, lists and finite numbers."""
    if isinstance(value, float):  # numpy's float64 is one
        return float(value) if math.isfinite(value) else None
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping) or _is_instance(value):
        return {str(key): _plain(item) for key, item in _items(value).items()}
    return value


def _items(value: Any) -> dict[Any, Any]:
    """What the encoder does not know by itself: a mapping, or a dataclass by its JSON keys."""
    if isinstance(value, Mapping):
        return dict(value)
    if not _is_instance(value):
        raise TypeError(f"{type(value).__name__} has no JSON form")
    return {key: getattr(value, name) for key, name in _keys(value.__class__)}


def _is_instance(value: Any) -> bool:
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


@cache
def _keys(kind: type[Any]) -> tuple[tuple[str, str], ...]:
    """Key in JSON and name of each field."""
    return tuple((f.metadata.get("key") or f.name, f.name) for f in dataclasses.fields(kind))


def json_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of an event, made from the dataclasses."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": SCHEMA,
        **_object(LandmarkEvent),
    }


def _object(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    properties = {}
    for spec in dataclasses.fields(kind):
        meta = spec.metadata
        text = f"{meta['doc']}, {meta['unit']}" if meta["unit"] else meta["doc"]
        shape = _shape(hints[spec.name], dict(meta["limits"]))
        properties[meta["key"] or spec.name] = {"description": text, **shape}
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _shape(hint: Any, limits: dict[str, Any]) -> dict[str, Any]:
    origin, args = get_origin(hint), get_args(hint)
    if hint is float or (float in args and type(None) in args):
        return {"type": ["number", "null"], **limits}
    if hint in (int, str):
        return {"type": {int: "integer", str: "string"}[hint], **limits}
    if origin is Literal:
        return {"enum": list(args)}
    if dataclasses.is_dataclass(hint):
        assert isinstance(hint, type)
        return _object(hint)
    if origin is tuple and args[-1] is ...:
        return {"type": "array", "items": _shape(args[0], {}), **limits}
    if origin is tuple:
        size = {"minItems": len(args), "maxItems": len(args)}
        return {"type": "array", "items": _shape(args[0], {}), **size}
    return {"type": "object", "additionalProperties": _shape(float, limits)}  # a mapping

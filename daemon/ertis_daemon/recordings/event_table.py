"""Events of a recording as a table: a landmark a row, degrees for people."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

from ertis_driver.errors import RecordingError
from ertis_driver.mcap_reader import read_entries

COLUMNS = (
    *("ping_index", "ping_time_ns", "device", "source", "model", "track_id", "state", "class"),
    *("probability", "range_m", "azimuth_deg", "elevation_deg", "snr_db", "radius_m"),
)


def write_event_table(path: Path, output: Path) -> int:
    """Write the events of a recording as CSV; returns how many rows that are.

    Raises
    ------
    RecordingError
        If the recording has no events, or a file cannot be read or written.
    """
    if output.exists():
        raise RecordingError(f"{output} exists: name another file, or remove it")
    part = output.with_name(output.name + ".part")
    rows = 0
    try:
        with part.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            for entry in read_entries(path):
                if entry.channel.topic == "events":
                    event = json.loads(bytes(entry.message.data))
                    found = [_row(event, item) for item in event["landmarks"]]
                    table.writerows(found)
                    rows += len(found)
        if rows:
            part.replace(output)
    except OSError as error:
        raise RecordingError(f"cannot write {output}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RecordingError(f"{path} holds an event that is none of ours: {error!r}") from error
    finally:
        part.unlink(missing_ok=True)
    if not rows:
        raise RecordingError(
            f"{path} holds no events: `ertis detect {path} --json` makes them, the daemon records "
            "them"
        )
    return rows


def _row(event: dict[str, Any], item: dict[str, Any]) -> list[Any]:
    told = {name: event.get(name) for name in COLUMNS[:5]} | {
        name: item.get(name) for name in ("track_id", "state", "class", "range_m", "snr_db")
    }
    told["radius_m"] = item.get("radius_m")
    told["probability"] = item.get("probabilities", {}).get(item.get("class"))
    for name in ("azimuth", "elevation"):
        angle = item.get(f"{name}_rad")
        told[f"{name}_deg"] = None if angle is None else round(math.degrees(angle), 4)
    return [told[name] for name in COLUMNS]

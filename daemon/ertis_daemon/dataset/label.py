"""What a person says about a ping."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from ertis_driver.dataset import NONE, DatasetRow

LABELS = ("r35", "r48", "r58", "r70", NONE)
FOLDER_NAME = "letters, digits, - _ . : it names a folder"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True, slots=True)
class Place:
    """What stays the same over many pings.

    environment, session : str
        Also folders' names.
    operator : str
    temperature_c : float
        Of the air.
    """

    environment: str
    session: str
    operator: str
    temperature_c: float


@dataclass(frozen=True, slots=True)
class Label:
    """What stands where; NaN for what is not known.

    label : str
    range_m, azimuth_rad, yaw_rad : float
        As in ``DatasetRow``.
    """

    label: str
    range_m: float = math.nan
    azimuth_rad: float = math.nan
    yaw_rad: float = math.nan

    def said(self, place: Place) -> dict[str, Any]:
        """As it is kept in the recording, where nobody corrects it."""
        row = DatasetRow("", self.label, self.range_m, self.azimuth_rad, self.yaw_rad)
        numbers = {
            name: None if value is None else round(value, 4)
            for name, value in row.values().items()
            if name in ("range_m", "azimuth_deg", "yaw_deg")
        }
        return {
            "label": self.label,
            **numbers,
            "environment": place.environment,
            "session": place.session,
            "operator": place.operator,
        }

    def __str__(self) -> str:
        """For prompts and messages."""
        parts = [self.label]
        if not math.isnan(self.range_m):
            parts.append(f"{self.range_m:.2f} m")
        if not math.isnan(self.azimuth_rad):
            parts.append(f"at {math.degrees(self.azimuth_rad):+.1f} deg")
        if not math.isnan(self.yaw_rad):
            parts.append(f"turned {math.degrees(self.yaw_rad):+.1f} deg")
        return " ".join(parts)


def is_folder_name(text: str) -> bool:
    """Whether a text may name a folder or be part of a file's name, on any system."""
    return _NAME.fullmatch(text) is not None

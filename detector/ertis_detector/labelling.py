"""Candidates of a recorded ping against its truth: which label each one trains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ertis_detector.detection import NONE, UNKNOWN, radius_m
from ertis_detector.detector import RING_OFFSET, Candidate

MATCH_RANGE_M = 0.06  # the located peak lies within the ring pattern of its own dish
MATCH_AZIMUTH_RAD = np.deg2rad(5.0)
# A dish is also heard by way of the floor and in the array sidelobes: neither a landmark at
# that place nor something else.
OWN_ECHO_RANGE_M = 0.25


def label_candidates(candidates: Sequence[Candidate], truth: Mapping[str, Any]) -> list[str | None]:
    """Label of each candidate; None for those that should not train anything.

    Parameters
    ----------
    candidates : of one ping
    truth : mapping
        As recordings hold it: ``landmarks`` and ``decoys``, each with ``label``, ``range_m``,
        ``azimuth_rad`` and ``visible``.

    Returns
    -------
    list of ``r35 ...``, ``unknown`` (a decoy), ``none``, or None (a dish turned too far away, or
    heard by another way)
    """
    labels: list[str | None] = []
    for candidate in candidates:
        landmark = _nearest(candidate, truth.get("landmarks", []))
        if landmark is not None:
            labels.append(str(landmark["label"]) if landmark["visible"] else None)
        elif _nearest(candidate, truth.get("decoys", [])) is not None:
            labels.append(UNKNOWN)
        elif _within(candidate, [*truth.get("landmarks", []), *truth.get("decoys", [])]):
            labels.append(None)
        else:
            labels.append(NONE)
    return labels


def _nearest(candidate: Candidate, items: Sequence[Mapping[str, Any]]) -> Mapping[str, Any] | None:
    at = candidate.location
    best, best_gap = None, MATCH_RANGE_M
    for item in items:
        ring_m = RING_OFFSET * (radius_m(str(item["label"])) or 0.0)
        gap = abs(at.range_m - item["range_m"] - ring_m)
        if gap < best_gap and abs(at.azimuth_rad - item["azimuth_rad"]) < MATCH_AZIMUTH_RAD:
            best, best_gap = item, gap
    return best


def _within(candidate: Candidate, items: Sequence[Mapping[str, Any]]) -> bool:
    return any(
        abs(candidate.location.range_m - item["range_m"]) < OWN_ECHO_RANGE_M for item in items
    )

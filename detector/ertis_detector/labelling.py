"""Candidates of a recorded ping against its truth: which label each one trains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ertis_detector.detection import NONE, UNKNOWN
from ertis_detector.readout import RING_OFFSET
from ertis_detector.scanner import Candidate

Place = Mapping[str, Any]

MATCH_RANGE_M = 0.06  # the located peak lies within the ring pattern of its own dish
MATCH_AZIMUTH_RAD, MATCH_ELEVATION_RAD = np.deg2rad(5.0), np.deg2rad(12.0)
# Further turned, no ring is lit and no size can be learnt: neither a landmark nor something else.
MAX_TILT_RAD = np.deg2rad(40.0)
# A dish is also heard by way of the floor and in the array sidelobes: neither a landmark at
# that place nor something else.
OWN_ECHO_RANGE_M = 0.25


def match_candidates(
    candidates: Sequence[Candidate], truth: Mapping[str, Any]
) -> list[tuple[str | None, Place | None]]:
    """Label of each candidate, and what of the truth it is.

    Parameters
    ----------
    candidates : of one ping
    truth : mapping
        As recordings hold it: ``landmarks`` and ``decoys``, each with ``label``, ``range_m``,
        ``azimuth_rad``, ``elevation_rad`` and ``radius_m``; ``tilt_rad`` and ``shadowed`` where
        known.

    Returns
    -------
    list of pairs
        ``r35 ...``, ``unknown`` (a decoy), ``none``, or None for what should not train anything: a
        dish turned too far away or hidden, or heard by another way. Then the landmark or decoy.
    """
    landmarks, decoys = truth.get("landmarks", []), truth.get("decoys", [])
    matched: list[tuple[str | None, Place | None]] = []
    for candidate in candidates:
        landmark, decoy = _nearest(candidate, landmarks), _nearest(candidate, decoys)
        if landmark is not None:
            lit = landmark.get("tilt_rad", 0.0) <= MAX_TILT_RAD and not landmark.get("shadowed")
            matched.append((str(landmark["label"]) if lit else None, landmark))
        elif decoy is not None:
            matched.append((UNKNOWN, decoy))
        elif any(
            abs(candidate.location.range_m - item["range_m"]) < OWN_ECHO_RANGE_M
            for item in landmarks
        ):
            matched.append((None, None))
        else:
            matched.append((NONE, None))
    return matched


def _nearest(candidate: Candidate, items: Sequence[Place]) -> Place | None:
    at = candidate.location
    best, best_gap = None, MATCH_RANGE_M
    for item in items:
        gap = abs(at.range_m - item["range_m"] - RING_OFFSET * item["radius_m"])
        if (
            gap < best_gap
            and abs(at.azimuth_rad - item["azimuth_rad"]) < MATCH_AZIMUTH_RAD
            and abs(at.elevation_rad - item["elevation_rad"]) < MATCH_ELEVATION_RAD
        ):
            best, best_gap = item, gap
    return best

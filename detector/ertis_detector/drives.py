"""What drives teach on which there was no landmark: how firmly a tracker believes in one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from ertis_detector.detection import Detection
from ertis_detector.followed import Followed
from ertis_detector.motion import Motion
from ertis_detector.tracker import Tracker


def peaks(
    drive: Iterable[tuple[Sequence[Detection], int, Motion | None]], tracker: Tracker
) -> list[float]:
    """The most that each thing met on a drive was ever believed to be a landmark.

    Parameters
    ----------
    drive
        What ``Tracker.update`` takes, ping by ping; no landmark may have been in hearing.
    tracker : Tracker
        A fresh one.

    Returns
    -------
    list of float
        ``Evidence.existence`` of each track, announced or not, nats.
    """
    best: dict[Followed, float] = {}
    for detections, time_ns, motion in drive:
        tracker.update(detections, time_ns, motion)
        for one in tracker.followed:
            best[one] = max(best.get(one, -math.inf), one.evidence.existence)
    return list(best.values())

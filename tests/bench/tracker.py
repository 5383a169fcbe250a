"""How often the tracker is wrong, and how soon right, in a statistical world. All simulated.

``python tests/bench/tracker.py [--hours N] [--ears NAME] [--per-hour N]``. It prints and judges; it
never fails. An hour takes a minute.
"""

from __future__ import annotations

import argparse
import math
import time
from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.stats import chi2
from tracker_world import EARS, PING_RATE_HZ, SIZES, Drive, Ears, Thing, drive, hear_thing

from ertis_detector.motion import Motion, PlanarPose
from ertis_detector.rates import DetectorRates
from ertis_detector.tracker import Tracker, TrackerSettings

PERIOD_NS = round(1e9 / PING_RATE_HZ)
BETWEEN_DRIVES_NS = 60_000_000_000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ears", choices=EARS, help="one detector only")
    parser.add_argument("--hours", type=float, default=5.0, help="without landmarks")
    parser.add_argument("--per-hour", type=float, default=1.0, help="false events allowed")
    parser.add_argument("--persistent", type=float, default=0.3, help="0.3 is measured")
    parser.add_argument("--overconfidence", type=float, default=1.0, help="1 is calibrated")
    parser.add_argument("--trials", type=int, default=500, help="landmarks of three pings")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for name in [args.ears] if args.ears else EARS:
        ears = EARS[name]
        rates = ears.rates(np.random.default_rng(args.seed))
        ears = replace(ears, overconfidence=args.overconfidence)
        settings = TrackerSettings(max_false_events_per_hour=args.per_hour)
        print(
            f"\n=== {name}: {rates}\n    announced from {settings.least_existence(rates):.2f} nats"
        )
        rng = np.random.default_rng(args.seed)
        landmark_free(ears, rates, settings, rng, args.hours, args.persistent)
        among_landmarks(ears, rates, settings, rng)
        for step_m in (0.07, 0.15, 0.3):
            three_pings(
                ears, rates, settings, np.random.default_rng(args.seed), step_m, args.trials
            )


def landmark_free(
    ears: Ears,
    rates: DetectorRates,
    settings: TrackerSettings,
    rng: np.random.Generator,
    hours: float,
    persistent: float,
) -> None:
    """False events an hour, with the upper end of the 95 % interval (Poisson, exact)."""
    tracker, now_ns, pings, events, spent_s = Tracker(rates, settings), 0, 0, 0, 0.0
    for _ in range(max(round(60 * hours), 1)):
        way = drive(ears, rng, persistent=persistent)
        now_ns += BETWEEN_DRIVES_NS
        for heard, motion in zip(way.heard, way.motions, strict=True):
            now_ns += PERIOD_NS
            start_s = time.perf_counter()
            tracks = tracker.update([one for one, _ in heard], now_ns, motion)
            spent_s += time.perf_counter() - start_s
            events += sum(track.state == "new" for track in tracks)
            pings += 1
    driven_h = pings / PING_RATE_HZ / 3600
    bound = chi2.ppf(0.975, 2 * (events + 1)) / 2 / driven_h
    print(
        f"  no landmark in {driven_h:.1f} h: {events} events, {events / driven_h:.2f} an hour, "
        f"at most {bound:.2f} (95 %); allowed {settings.false_tracks_per_hour:g}; "
        f"{1e3 * spent_s / pings:.2f} ms a ping"
    )


def among_landmarks(
    ears: Ears,
    rates: DetectorRates,
    settings: TrackerSettings,
    rng: np.random.Generator,
    drives: int = 10,
) -> None:
    """What is announced on the way past landmarks, after how long, and how true the rest is."""
    counts: Counter[str] = Counter()
    waits: list[int] = []
    squared: list[float] = []
    for _ in range(drives):
        way = drive(ears, rng, landmarks_per_m2=0.05)
        in_view = Counter(thing_id for line in way.seen for thing_id in landmarks_of(line))
        counts["met"] += sum(pings >= 10 for pings in in_view.values())
        _follow(way, Tracker(rates, settings), counts, waits, squared)
    located = counts["right"] + counts["wrong size"]
    print(
        f"  {counts['met']} landmarks in view for 10 pings or more, {located} announced: "
        f"{counts['right']} right, {counts['wrong size']} of another size; {counts['false']} where "
        f"none is; median {np.median(waits) if waits else math.nan:g} pings in view before"
    )
    spread = 1.96 * math.sqrt(6 / max(located, 1))
    print(
        f"  normalised squared error of {len(squared)} reports: {np.mean(squared):.2f}, expected "
        f"3 +- {spread:.2f} (as if a track's reports were one)"
    )


def landmarks_of(line: list[tuple[Thing, np.ndarray]]) -> list[int]:
    return [id(thing) for thing, _ in line if thing.label in SIZES]


def _follow(
    way: Drive, tracker: Tracker, counts: Counter[str], waits: list[int], squared: list[float]
) -> None:
    in_view: Counter[int] = Counter()
    for ping, (heard, motion) in enumerate(zip(way.heard, way.motions, strict=True)):
        in_view.update(landmarks_of(way.seen[ping]))
        for track in tracker.update([one for one, _ in heard], ping * PERIOD_NS, motion):
            if track.state == "lost":
                continue
            own = track.detection
            seen = np.array([own.range_m, own.azimuth_rad, own.elevation_rad])
            near = [
                (thing, place)
                for thing, place in way.seen[ping]
                if thing.label in SIZES and (np.abs(seen - place) < (0.1, 0.07, 0.2)).all()
            ]
            if near:
                gap = seen - near[0][1]
                squared.append(float(gap @ np.linalg.solve(np.array(own.covariance), gap)))
            if track.state == "new":
                right = bool(near) and near[0][0].label == own.label
                counts["right" if right else "wrong size" if near else "false"] += 1
                waits += [in_view[id(near[0][0])]] if near else []


def three_pings(
    ears: Ears,
    rates: DetectorRates,
    settings: TrackerSettings,
    rng: np.random.Generator,
    step_m: float,
    trials: int,
) -> None:
    """What three pings of a sensor that passes one landmark are enough for."""
    counts: Counter[str] = Counter()
    while counts["trials"] < trials:
        step = PlanarPose(0.5 * step_m, 0.87 * step_m, 0.0)
        poses = [PlanarPose(0.0, 0.0, 0.0)]
        poses += [poses[-1].then(step), poses[-1].then(step).then(step)]
        range_m, angle = rng.uniform(1.0, 3.5), math.radians(rng.uniform(-20.0, 20.0))
        place = np.array([range_m * math.cos(angle), range_m * math.sin(angle), 0.0])
        own = np.random.default_rng(rng.integers(2**63))
        landmark = Thing(str(rng.choice(SIZES)), place, own, persistent=0.0)
        heard, seen = [[], [], []], [[], [], []]
        hear_thing(landmark, poses, ears, heard, seen)
        if all(seen):
            counts["trials"] += 1
            counts.update(_three(landmark, poses, heard, rates, settings))
    parts = ", ".join(
        f"{word} {100 * counts[word] / trials:.1f} %"
        for word in ("most probable size right", "announced right", "announced wrong")
    )
    print(f"  three pings {step_m:g} m apart, {trials} landmarks at 1 to 3.5 m: {parts}")


def _three(
    landmark: Thing,
    poses: list[PlanarPose],
    heard: list,
    rates: DetectorRates,
    settings: TrackerSettings,
) -> list[str]:
    tracker = Tracker(rates, settings)
    step = Motion.between(poses[0], poses[1])
    eager_settings = TrackerSettings(max_false_events_per_hour=1e9)
    eager, told, best = Tracker(rates, eager_settings), [], ""
    for ping, line in enumerate(heard):
        detections, motion = [one for one, _ in line], step if ping else None
        for track in tracker.update(detections, ping * PERIOD_NS, motion):
            if track.state == "new":
                right = track.detection.label == landmark.label
                told.append("announced right" if right else "announced wrong")
        for track in eager.update(detections, ping * PERIOD_NS, motion):
            best = track.detection.label
    return [*told, *(["most probable size right"] if best == landmark.label else [])]


if __name__ == "__main__":
    main()

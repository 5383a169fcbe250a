"""Detector and tracker over simulated sound: how soon right, how often wrong. All simulated.

``python tests/bench/tracker_sound.py --scenes 400`` drives past the paper's landmarks (and none) in
rooms of the seven environments, three pings each; ``--hours 1`` drives through such rooms without
a landmark, at 7 Hz. The rooms are drawn from a seed that no training and no evaluation uses.
``--calibrate DATASET`` (as ``ertis simulate --dataset DATASET --seed 2`` makes it) does as
somebody would who recorded, labelled and drove in some rooms and goes to others: in each
environment the model is one calibrated on all others, and its tracker on drives through them. It
prints and judges; it never fails. An hour of driving takes 20 minutes of one core, twice as many to
calibrate on; 400 scenes take a minute and a half.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import pathlib
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ertis_daemon.calibrating import calibrate
from ertis_daemon.config import SonarConfig
from ertis_daemon.pipeline import build_detector, build_tracker
from ertis_daemon.workers import Workers
from ertis_detector.detection import Detection
from ertis_detector.drives import peaks
from ertis_detector.evaluate import CONDITIONS
from ertis_detector.false_tracks import FalseTracks
from ertis_detector.intervals import garwood, wilson
from ertis_detector.matching import TrueLandmark, match
from ertis_detector.model import (
    FOLLOWING_PROBABILITY,
    TRACKING_PROBABILITY,
    load_model,
    save_model,
)
from ertis_detector.motion import Motion, PlanarPose
from ertis_driver.audio import PdmDecoder
from ertis_driver.chirp import DEFAULT_CHIRP
from ertis_driver.dataset import METADATA
from ertis_driver.device import Settings
from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS
from ertis_simulator.drives import PING_RATE_HZ, straight_ahead
from ertis_simulator.environments import ENVIRONMENTS, draw_place
from ertis_simulator.paper_dataset import VARIANTS, PlannedPing, build_scene, plan
from ertis_simulator.path import Path
from ertis_simulator.placement import stand_sonar
from ertis_simulator.scene import Scene

SEED, CALIBRATING_SEED = 20_261_122, 777_001
PINGS_A_ROOM = 10
STEP_M = 0.2  # between the three pings
ASKED = next(name for name in CONDITIONS if name.startswith("tilt"))
NOTHING = "nothing"


@dataclass(frozen=True, slots=True)
class Ping:
    """What stood there, what was reported from 0.5 on, and what was announced after it."""

    truth: tuple[TrueLandmark, ...]
    reports: tuple[Detection, ...]
    announced: tuple[Detection, ...]


@dataclass(frozen=True, slots=True)
class Heard:
    """What became of one landmark that met the target's conditions at each of its pings.

    first : label of the first ping's report of it
    announced : label
    """

    label: str
    first: str
    announced: str


@dataclass(frozen=True, slots=True)
class Driven:
    """One drive: pings, reports of what is no landmark, false events (what is taken for what)."""

    pings: int
    false_reports: int
    false_events: tuple[str, ...]
    landmarks: tuple[Heard, ...] = ()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=0, help="three pings each")
    parser.add_argument("--hours", type=float, default=0.0, help="at 7 Hz, without landmarks")
    parser.add_argument("--per-hour", type=float, default=1.0, help="false events allowed")
    parser.add_argument("--calibrate", type=pathlib.Path, metavar="DATASET", help="elsewhere")
    parser.add_argument("--drive-hours", type=float, default=1.0, help="to calibrate trackers on")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    args = parser.parse_args()
    if not (args.scenes or args.hours):
        args.scenes = 400
    config = SonarConfig(ping_rate_hz=PING_RATE_HZ)
    tracker = dataclasses.replace(config.tracker, max_false_events_per_hour=args.per_hour)
    config = dataclasses.replace(config, tracker=tracker)
    beside = args.calibrate.parent if args.calibrate else None  # where hard links reach
    with tempfile.TemporaryDirectory(dir=beside) as folder:
        models = {}
        if args.calibrate:
            models = calibrated_elsewhere(args.calibrate, pathlib.Path(folder), args.workers)
            driven_elsewhere(Listener(config, models), args.drive_hours, Workers(args.workers))
        listener = Listener(config, models)
        if args.scenes:
            tell_three(list(Workers(args.workers)(Three(listener), plan(args.scenes))))
        if args.hours:
            tell_free(free_drives(Workers(args.workers), listener, args.hours))


@dataclass(frozen=True, slots=True)
class Listener:
    """Who hears: the daemon's settings, and of some environments the model; else the shipped."""

    config: SonarConfig
    models: Mapping[str, str]


def calibrated_elsewhere(data: pathlib.Path, folder: pathlib.Path, workers: int) -> dict[str, str]:
    """For each environment, a model calibrated on all others of a data set."""
    models = {}
    head, *lines = (data / METADATA).read_text().splitlines()
    for environment in ENVIRONMENTS:
        others, path = folder / environment, folder / f"{environment}.safetensors"
        others.mkdir()
        kept = [line for line in lines if not line.startswith(f"{environment}/")]
        (others / METADATA).write_text("\n".join([head, *kept]) + "\n")
        for name in ENVIRONMENTS.keys() - {environment}:
            shutil.copytree(data / name, others / name, copy_function=os.link)
        made = calibrate([others], None, workers)
        save_model(made.model, path)
        models[environment] = str(path)
        law = made.law
        print(
            f"  without {environment}: slope {law.slope:.2f}, offset {law.offset:.2f}", flush=True
        )
    return models


def driven_elsewhere(listener: Listener, hours: float, workers: Workers) -> None:
    """Write on each model's card what drives through all other environments gave."""
    found: dict[str, list[float]] = {name: [] for name in listener.models}
    pings = dict.fromkeys(listener.models, 0)
    count = 0
    while max(pings.values()) < hours * 3600 * PING_RATE_HZ:
        numbers = range(count, count := count + 8 * workers.count)
        for heard, believed in workers(Believed(listener), numbers):
            for name, some in believed.items():
                found[name] += some
                pings[name] += heard
    for name, path in listener.models.items():
        law, model = FalseTracks.of(found[name], pings[name]), load_model(pathlib.Path(path))
        tracking = {**model.card.tracking, **law.figures()}
        card = dataclasses.replace(model.card, tracking=tracking)
        save_model(dataclasses.replace(model, card=card), pathlib.Path(path))
        level = law.level(1 / 3600 / PING_RATE_HZ)
        print(
            f"  without {name}: {len(found[name])} tracks in {pings[name]} pings of drives, "
            f"one an hour passes {level:.1f} nats (fade {law.fade:.2f})",
            flush=True,
        )


@dataclass(frozen=True)
class Believed:
    """A drive without a landmark, heard by the models that are not for its environment."""

    listener: Listener

    def __call__(self, number: int) -> tuple[int, dict[str, list[float]]]:
        """Pings, and what each model's tracker believed of each thing met."""
        scene, num_pings, environment = free_scene(CALIBRATING_SEED, number)
        settings = Settings()
        detectors = {
            name: build_detector(settings, scene.air, path, min_probability=FOLLOWING_PROBABILITY)
            for name, path in self.listener.models.items()
            if name != environment
        }
        any_of_them = next(iter(detectors.values()))  # they scan alike
        told: dict[str, list[tuple[list[Detection], int, Motion | None]]]
        told = {name: [] for name in detectors}
        for audio, _, time_ns, motion in moved(scene, num_pings):
            scan = any_of_them.scan(audio)
            for name, detector in detectors.items():
                told[name].append((detector.judge(scan), time_ns, motion))
        trackers = {
            name: build_tracker(self.listener.config, settings, one.model.card.tracking)
            for name, one in detectors.items()
        }
        return num_pings, {name: peaks(told[name], trackers[name]) for name in told}


@dataclass(frozen=True)
class Three:
    """Three pings of a drive past what a data set's ping would hear once."""

    listener: Listener

    def __call__(self, ping: PlannedPing) -> Driven:
        """Drive straight, up to 60 degrees off the heading."""
        seed = SEED + ping.number // PINGS_A_ROOM // len(ENVIRONMENTS)
        still = build_scene(seed, ping, VARIANTS["paper"]).scene
        rng = np.random.default_rng([SEED, ping.number, 1])
        yaw = still.start.yaw_rad
        way = yaw + rng.uniform(-np.pi / 3, np.pi / 3)
        scene = moving(still, yaw, way, 2 * STEP_M, STEP_M, 1.0)
        pings = list(listen(scene, 3, self.listener, ping.environment))
        asked = [
            number
            for number in range(len(pings[0].truth))
            if all(CONDITIONS[ASKED](ping.truth[number]) for ping in pings)
        ]
        return driven(pings, tuple(_fate(pings, number) for number in asked))


@dataclass(frozen=True)
class Free:
    """A drive through a room without a landmark."""

    listener: Listener

    def __call__(self, number: int) -> Driven:
        """Drive it."""
        scene, num_pings, name = free_scene(SEED, number)
        return driven(list(listen(scene, num_pings, self.listener, name)))


def free_scene(seed: int, number: int) -> tuple[Scene, int, str]:
    """A drive along a room until a wall is near, its pings, and what room it is."""
    rng = np.random.default_rng([seed, number, 2])
    name = list(ENVIRONMENTS)[number % len(ENVIRONMENTS)]
    place = draw_place(ENVIRONMENTS[name], rng)
    still = Scene(
        room=place.room,
        start=stand_sonar(place, rng),
        clutter=place.clutter,
        air=place.air,
        seed=int(rng.integers(2**31)),
        things=place.things,
        noise=place.noise,
    )
    return (*straight_ahead(still), name)


def moving(
    scene: Scene, yaw_rad: float, way_rad: float, length_m: float, step_m: float, period_s: float
) -> Scene:
    """The same scene, driven through in a straight line."""
    x, y, _ = scene.start.position_m
    end = (x + length_m * math.cos(way_rad), y + length_m * math.sin(way_rad))
    times_s = (0.0, length_m / step_m * period_s)
    path = Path(times_s, ((x, y), end), (yaw_rad, yaw_rad))
    return dataclasses.replace(scene, path=path, ping_period_s=period_s)


def moved(
    scene: Scene, num_pings: int
) -> Iterator[tuple[npt.NDArray[np.float32], dict[str, Any], int, Motion | None]]:
    """Audio, truth, time and what odometry tells of each ping; the audio until the next."""
    chirp = DEFAULT_CHIRP.samples(AUDIO_RATE_HZ)
    before = None
    for number in range(num_pings):
        words, truth = scene.hear_and_judge(number, DEFAULT_NUM_WORDS, chirp)
        at = scene.pose(number)
        pose = PlanarPose(at.position_m[0], at.position_m[1], at.yaw_rad)
        motion = Motion.between(before, pose) if before else None
        before = pose
        time_ns = round(number * scene.ping_period_s * 1e9)
        yield decoder().decode(words).audio, truth, time_ns, motion


def listen(scene: Scene, num_pings: int, listener: Listener, environment: str) -> Iterator[Ping]:
    """Hear, detect and track as the daemon does, told by odometry how the sensor moves."""
    settings = Settings()
    model = listener.models.get(environment, "")
    detector = build_detector(settings, scene.air, model, min_probability=FOLLOWING_PROBABILITY)
    tracker = build_tracker(listener.config, settings, detector.model.card.tracking)
    for audio, truth, time_ns, motion in moved(scene, num_pings):
        detections = detector.detect(audio)
        tracks = tracker.update(detections, time_ns, motion)
        yield Ping(
            tuple(map(TrueLandmark.of, truth["landmarks"])),
            tuple(one for one in detections if one.landmark_probability >= TRACKING_PROBABILITY),
            tuple(track.detection for track in tracks if track.state == "new"),
        )


@cache
def decoder() -> PdmDecoder:
    """One a process."""
    return PdmDecoder()


def driven(pings: Sequence[Ping], landmarks: tuple[Heard, ...] = ()) -> Driven:
    """Count what was false of a drive."""
    events: list[str] = []
    for ping in pings:
        for told in ping.announced:
            label = _label_of(ping.truth, told)
            if label != told.label:
                events.append(f"{told.label} for {label}")
    false_reports = sum(len(match(ping.truth, ping.reports).false) for ping in pings)
    return Driven(len(pings), false_reports, tuple(events), landmarks)


def _fate(pings: Sequence[Ping], number: int) -> Heard:
    first = match(pings[0].truth, pings[0].reports).found.get(number)
    announced = NOTHING
    for ping in pings:
        found = match(ping.truth, ping.announced).found.get(number)
        if found is not None:
            announced = ping.announced[found].label
    return Heard(
        pings[0].truth[number].label,
        NOTHING if first is None else pings[0].reports[first].label,
        announced,
    )


def _label_of(truth: Sequence[TrueLandmark], told: Detection) -> str:
    pairs = match(truth, [told])
    return next((truth[number].label for number in (*pairs.found, *pairs.beyond)), NOTHING)


def free_drives(workers: Workers, listener: Listener, hours: float) -> list[Driven]:
    """As many drives as make the hours."""
    done: list[Driven] = []
    pings = 0
    while pings < hours * 3600 * PING_RATE_HZ:
        numbers = range(len(done), len(done) + 8 * workers.count)
        done.extend(workers(Free(listener), numbers))
        pings = sum(one.pings for one in done)
        print(f"  {pings} pings, {sum(len(one.false_events) for one in done)} events", flush=True)
    return done


def tell_three(drives: Sequence[Driven]) -> None:
    """What became of landmarks in the target's conditions, and how often it was wrong."""
    heard = [one for drive in drives for one in drive.landmarks]
    print(f"{len(drives)} simulated scenes, three pings {STEP_M} m apart; {len(heard)} landmarks")
    print(f"with {ASKED} at each of them")
    for name, told in (
        ("first ping alone, right size, from 0.5 on", [one.first == one.label for one in heard]),
        ("announced within three, right size", [one.announced == one.label for one in heard]),
    ):
        low, high = wilson(sum(told), len(told))
        print(
            f"  {name}: {sum(told)}, {sum(told) / max(len(told), 1):.1%} ({low:.1%} to {high:.1%})"
        )
    _tell_false(drives)


def tell_free(drives: Sequence[Driven]) -> None:
    """False events an hour."""
    hours = sum(one.pings for one in drives) / PING_RATE_HZ / 3600
    print(f"{len(drives)} simulated drives without a landmark, {hours:.2f} h at {PING_RATE_HZ} Hz")
    _tell_false(drives)


def _tell_false(drives: Sequence[Driven]) -> None:
    pings = sum(one.pings for one in drives)
    reports = sum(one.false_reports for one in drives)
    events = Counter(event for one in drives for event in one.false_events)
    count = sum(events.values())
    low, high = garwood(count, pings / PING_RATE_HZ / 3600)
    print(f"  reports of what is no landmark, from 0.5 on: {reports / pings:.4f} a ping")
    print(f"  false events: {count} in {pings} pings, {low:.2f} to {high:.2f} an hour (Poisson)")
    for event, number in events.most_common():
        print(f"    {number} x {event}")


if __name__ == "__main__":
    main()

"""A statistical world for the tracker: things, a sensor that drives past them, what is reported.

No sound: each thing's echo is a point in a space of features, whose disturbance changes as the view
does. The detector's probabilities are exact, by Bayes, so nothing but the tracker is judged.
Everything here is simulated.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from ertis_detector.detection import Detection
from ertis_detector.motion import Motion, PlanarPose
from ertis_detector.rates import DetectorRates
from ertis_detector.views import CLASS_LENGTHS, PLACE_LENGTHS
from ertis_detector.visibility import FieldOfView

SIZES = ("r35", "r48", "r58", "r70")
LABELS = (*SIZES, "none", "unknown")
SIGMA = np.array([0.006, math.radians(0.7), math.radians(2.0)])
FIELD = FieldOfView()
PING_RATE_HZ = 7.0
_NUM_WAVES = 80


@dataclass(frozen=True)
class Ears:
    """A detector in numbers: how far apart the classes lie, in units of the disturbance.

    landmark_apart, size_apart : of any landmark from clutter; of the sizes from each other
    landmark_share : of echoes in the training data
    least_probability : from which an echo is reported
    clutter_per_ping : echoes in view that are no landmark
    overconfidence : by which the log-probabilities are stretched; 1 if they are calibrated
    """

    landmark_apart: float
    size_apart: float
    least_probability: float
    landmark_share: float = 0.16
    clutter_per_ping: float = 4.0
    overconfidence: float = 1.0

    def means(self) -> np.ndarray:
        """Shape (num_labels, num_features)."""
        means = np.zeros((len(LABELS), 6))
        means[:4, 0] = self.landmark_apart
        means[:4, 1:5] = self.size_apart * np.eye(4)
        means[5, 5] = 2.0
        return means

    def prior(self) -> np.ndarray:
        rest = 1.0 - self.landmark_share
        return np.array([*[self.landmark_share / 4] * 4, 0.8 * rest, 0.2 * rest])

    def probabilities(self, features: np.ndarray) -> np.ndarray:
        means = self.means()
        logs = features @ means.T - 0.5 * (means**2).sum(axis=1) + np.log(self.prior())
        logs = self.overconfidence * logs
        values = np.exp(logs - logs.max(axis=1, keepdims=True))
        return values / values.sum(axis=1, keepdims=True)

    def rates(self, rng: np.random.Generator, count: int = 400_000) -> DetectorRates:
        """Measured as a model's card is: on independent echoes."""
        which = rng.choice(len(LABELS), count, p=self.prior())
        told = self.probabilities(self.means()[which] + rng.normal(size=(count, 6)))
        reported = told[:, :4].sum(axis=1) >= self.least_probability
        is_landmark = which < 4
        return DetectorRates(
            max(float((reported & ~is_landmark).sum() / (~is_landmark).sum()), 1e-7)
            * self.clutter_per_ping,
            float((reported & is_landmark).sum() / reported.sum()),
            float(reported[is_landmark].mean()),
            self.clutter_per_ping,
        )


EARS = {
    # As the target asks of one ping: 90 % found with the right size, one false report a minute.
    "target": Ears(2.8, 3.9, 0.93),
    # The same ears that report more, and leave it to the tracker.
    "target, reporting more": Ears(2.8, 3.9, 0.3),
    # About what the first model does: a false report every eighth ping, half the landmarks found.
    "weak": Ears(1.0, 2.1, 0.5),
}


@dataclass
class Thing:
    """One thing in the world and all that is random about its echo.

    persistent, noisy : parts of the disturbance that never change, and that always do
    """

    label: str
    place_m: np.ndarray  # x, y, z
    rng: np.random.Generator
    persistent: float = 0.3
    noisy: float = 0.15

    def __post_init__(self) -> None:
        rng = self.rng
        self._stays = rng.normal(size=6)
        # Sums of waves with Cauchy wave numbers have the correlation exp(-distance) (Bochner).
        self._numbers = rng.normal(size=(6, _NUM_WAVES, 3)) / np.abs(
            rng.normal(size=(6, _NUM_WAVES, 1))
        )
        self._phases = rng.uniform(0, math.tau, (6, _NUM_WAVES))

    def disturbance(self, views: np.ndarray) -> np.ndarray:
        """Shape (n, 6), each of unit variance, for views (n, 3) of side, range and bearing."""
        turns = np.einsum("nk,dwk->ndw", views / CLASS_LENGTHS, self._numbers) + self._phases
        changes = math.sqrt(2 / _NUM_WAVES) * np.cos(turns).sum(axis=2)
        steady = math.sqrt(self.persistent) * self._stays
        steady = steady + math.sqrt(1 - self.persistent) * changes
        noise = self.rng.normal(size=steady.shape)
        return math.sqrt(1 - self.noisy) * steady + math.sqrt(self.noisy) * noise

    def place_errors(self, views: np.ndarray) -> np.ndarray:
        """Shape (n, 3), in sigma: a part that stays, one that changes on the way, one of a ping."""
        stays, slow = self.rng.normal(size=3), self.rng.normal(size=3)
        errors = np.empty((len(views), 3))
        for n, view in enumerate(views):
            if n:
                step = (view - views[n - 1]) / PLACE_LENGTHS
                alike = math.exp(-float(np.sqrt(step @ step)))
                slow = alike * slow + math.sqrt(1 - alike**2) * self.rng.normal(size=3)
            noise = self.rng.normal(size=3)
            errors[n] = 0.5 * stays + math.sqrt(0.65) * slow + math.sqrt(0.1) * noise
        return errors


@dataclass
class Drive:
    """What one drive past things gives: per ping the detections, their makers, and the motion.

    poses : of the sensor; things : in the world; seen : per ping (thing, true place) in view
    """

    poses: list[PlanarPose]
    motions: list[Motion | None]
    heard: list[list[tuple[Detection, Thing | None]]]
    seen: list[list[tuple[Thing, np.ndarray]]]


def drive(
    ears: Ears,
    rng: np.random.Generator,
    *,
    seconds: float = 60.0,
    speed_m_s: float = 0.5,
    landmarks_per_m2: float = 0.0,
    transient_share: float = 0.2,
    persistent: float = 0.3,
    ping_rate_hz: float = PING_RATE_HZ,
) -> Drive:
    """Drive a winding way through new things."""
    poses = _way(rng, round(seconds * ping_rate_hz), speed_m_s / ping_rate_hz, ping_rate_hz)
    area_m2 = FIELD.max_azimuth_rad * (FIELD.max_range_m**2 - FIELD.min_range_m**2)
    clutter_per_m2 = (1 - transient_share) * ears.clutter_per_ping / area_m2
    things = _scatter(poses, rng, clutter_per_m2, landmarks_per_m2, persistent)
    heard: list[list[tuple[Detection, Thing | None]]] = [[] for _ in poses]
    seen: list[list[tuple[Thing, np.ndarray]]] = [[] for _ in poses]
    for thing in things:
        hear_thing(thing, poses, ears, heard, seen)
    _hear_transients(ears, rng, transient_share, heard)
    motions: list[Motion | None] = [None]
    motions += [_odometry(a, b, rng) for a, b in itertools.pairwise(poses)]
    for line in heard:
        line.sort(key=lambda item: -item[0].probabilities[item[0].label])
    return Drive(poses, motions, heard, seen)


def _way(
    rng: np.random.Generator, count: int, step_m: float, ping_rate_hz: float
) -> list[PlanarPose]:
    poses, turn = [PlanarPose(0.0, 0.0, 0.0)], 0.0
    for _ in range(count - 1):
        turn = 0.95 * turn + rng.normal(0, math.radians(6.0)) / ping_rate_hz
        poses.append(poses[-1].then(PlanarPose(step_m, 0.0, turn)))
    return poses


def _odometry(before: PlanarPose, after: PlanarPose, rng: np.random.Generator) -> Motion:
    """True motion, as wrong as it says."""
    exact = Motion.between(before, after)
    x, y, yaw = rng.multivariate_normal(
        [exact.step.x_m, exact.step.y_m, exact.step.yaw_rad], exact.covariance
    )
    return Motion(PlanarPose(x, y, yaw), exact.covariance)


def _scatter(
    poses: list[PlanarPose],
    rng: np.random.Generator,
    clutter_per_m2: float,
    landmarks_per_m2: float,
    persistent: float,
) -> list[Thing]:
    """Things wherever the sensor comes near."""
    way = np.array([(pose.x_m, pose.y_m) for pose in poses])
    low, high = way.min(axis=0) - FIELD.max_range_m, way.max(axis=0) + FIELD.max_range_m
    area_m2 = float(np.prod(high - low))
    things = []
    for density, labels, share in (
        (clutter_per_m2, ("none", "unknown"), (0.8, 0.2)),
        (landmarks_per_m2, SIZES, None),
    ):
        for _ in range(rng.poisson(density * area_m2)):
            place = np.array([*rng.uniform(low, high), rng.normal(0, 0.1)])
            label = str(rng.choice(labels, p=share))
            things.append(
                Thing(label, place, np.random.default_rng(rng.integers(2**63)), persistent)
            )
    return things


def hear_thing(
    thing: Thing,
    poses: list[PlanarPose],
    ears: Ears,
    heard: list[list[tuple[Detection, Thing | None]]],
    seen: list[list[tuple[Thing, np.ndarray]]],
) -> None:
    at = np.array([(pose.x_m, pose.y_m, 0.0) for pose in poses])
    yaw = np.unwrap([pose.yaw_rad for pose in poses])
    x, y, z = (thing.place_m - at).T
    across, bearing = np.hypot(x, y), np.arctan2(y, x)
    azimuth = (bearing - yaw + np.pi) % math.tau - np.pi
    true = np.stack([np.hypot(across, z), azimuth, np.arctan2(z, across)], axis=1)
    (pings,) = np.nonzero([FIELD.holds(place) for place in true])
    if not pings.size:
        return
    views = np.stack([np.unwrap(bearing[pings]), true[pings, 0], azimuth[pings]], axis=1)
    features = ears.means()[LABELS.index(thing.label)] + thing.disturbance(views)
    told = ears.probabilities(features)
    measured = true[pings] + SIGMA * thing.place_errors(views)
    for ping, row, place, exact in zip(pings, told, measured, true[pings], strict=True):
        seen[ping].append((thing, exact))
        if row[:4].sum() >= ears.least_probability:
            heard[ping].append((_detection(row, place), thing))


def _hear_transients(
    ears: Ears,
    rng: np.random.Generator,
    share: float,
    heard: list[list[tuple[Detection, Thing | None]]],
) -> None:
    """Echoes that are there for one ping only: noise, passing things."""
    pings = np.repeat(np.arange(len(heard)), rng.poisson(share * ears.clutter_per_ping, len(heard)))
    told = ears.probabilities(rng.normal(size=(pings.size, 6)))
    for ping, row in zip(pings, told, strict=True):
        if row[:4].sum() >= ears.least_probability:
            place = np.array(
                [
                    rng.uniform(FIELD.min_range_m, FIELD.max_range_m),
                    rng.uniform(-1, 1) * FIELD.max_azimuth_rad,
                    rng.uniform(-1, 1) * FIELD.max_elevation_rad,
                ]
            )
            heard[ping].append((_detection(row, place), None))


def _detection(row: np.ndarray, place: np.ndarray) -> Detection:
    covariance = tuple(tuple(line) for line in np.diag(SIGMA**2).tolist())
    return Detection(
        SIZES[int(row[:4].argmax())],
        {label: float(p) for label, p in zip(LABELS, row, strict=True)},
        float(place[0]),
        float(place[1]),
        float(place[2]),
        covariance,
        25.0,
    )

"""The contests: what is timed, against what, on which frames."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from importlib import resources

import numpy as np
import scipy.signal
from timing import measure, print_table, print_target
from user_script import UserScript, bits_of

from ertis_daemon.config import Config
from ertis_daemon.events import SCHEMA, LandmarkEvent, LandmarkReport
from ertis_daemon.pipeline import Heard, build_detector, build_pipeline, build_scanner
from ertis_detector.detector import LandmarkDetector
from ertis_detector.proposals import propose
from ertis_detector.scanner import Scanner
from ertis_driver.audio import PdmDecoder
from ertis_driver.audio_filter import TAPS, UNITY
from ertis_driver.chirp import Chirp
from ertis_driver.device import Settings
from ertis_driver.frame import AUDIO_RATE_HZ, DEFAULT_NUM_WORDS, PdmFrame
from ertis_driver.geometry import mic_positions_m
from ertis_driver.halfword import find_corrupt_bits

CEILING_HZ = 27.5  # a frame takes 36.4 ms to listen to
AIR = Config().air


def demo_words(chirp: Chirp) -> np.ndarray:
    from ertis_simulator.scene_file import load_scene

    with resources.as_file(resources.files("ertis_simulator") / "scenes/demo.yaml") as path:
        scene = load_scene(path)
    return scene.hear(0, DEFAULT_NUM_WORDS, chirp.samples(AUDIO_RATE_HZ))


def empty_words(chirp: Chirp) -> np.ndarray:
    """Nothing to return sound: no wall, no floor, no landmark; only the sensor's own noise."""
    from ertis_simulator.path import Pose
    from ertis_simulator.room import Room
    from ertis_simulator.scene import Scene

    everywhere = (-np.inf, np.inf)
    room = Room(everywhere, everywhere, floor_reflection=0.0)
    scene = Scene(room, Pose((0.0, 0.0, 0.6), 0.0))
    return scene.hear(0, DEFAULT_NUM_WORDS, chirp.samples(AUDIO_RATE_HZ))


def scanner_for(chirp: Chirp) -> Scanner:
    return build_scanner(Settings(chirp=chirp), AIR)


def event_json(frame: PdmFrame, heard: Heard) -> bytes:
    """The event as the service publishes it."""
    reports = []
    for track in heard.tracks:
        one = track.detection
        fields = {f.name: getattr(one, f.name) for f in dataclasses.fields(one)}
        fields |= {"radius_m": one.radius_m}
        reports.append(LandmarkReport(track_id=track.track_id, state=track.state, **fields))
    return LandmarkEvent(
        schema=SCHEMA,
        device="bench",
        ping_index=frame.ping_index,
        ping_time_ns=frame.ping_time_ns,
        time_uncertainty_ns=0,
        frame_id="sonar",
        source="sim",
        model="bench",
        landmarks=tuple(reports),
        speed_of_sound_m_s=AIR.speed_of_sound_m_s,
        temperature_c=20.0,
    ).to_json()


def bench_audio(
    words: np.ndarray, script: UserScript, rounds: int, rng: np.random.Generator
) -> None:
    decoder = PdmDecoder()
    taps, audio = (TAPS / UNITY).astype(np.float32), decoder.decode(words).audio

    def upfirdn() -> np.ndarray:
        return scipy.signal.upfirdn(taps, bits_of(words).astype(np.float32), 1, 10, axis=1)

    bits = bits_of(words).astype(np.float32)
    contenders: dict[str, Callable[[], object]] = {
        "ours, mending included": lambda: decoder.decode(words, audio),
        "user script (unpack, Butterworth, band-pass)": lambda: script.audio(words),
        "upfirdn float32, same taps, with unpacking": upfirdn,
        "upfirdn float32, same taps, bits given": lambda: scipy.signal.upfirdn(
            taps, bits, 1, 10, axis=1
        ),
        "copying words and audio": lambda: (np.copy(words), np.copy(audio)),
    }
    times = measure(contenders, rounds, rng)
    print_table("PDM to audio", times, "ours, mending included")
    ours, user, _, bare, copy = (times[name].min() for name in contenders)
    print_target("x the user script", user / ours, 40)
    print_target("x upfirdn, bits given (a favour to it)", bare / ours, 8)
    print_target("x the copy bound", ours / copy, 10, at_most=True)


def bench_image(
    words: np.ndarray, scanner: Scanner, script: UserScript, rounds: int, rng: np.random.Generator
) -> None:
    audio = PdmDecoder().decode(words).audio
    audio64 = audio.astype(np.float64)
    contenders: dict[str, Callable[[], object]] = {
        "ours": lambda: scanner.image(audio),
        "user NumPy (integer delays, 0.5 to 5 m)": lambda: script.image(audio64),
    }
    times = measure(contenders, rounds, rng)
    print_table("Matched filter and energyscape, 91 directions", times, "ours")
    ours, user = (times[name].min() for name in contenders)
    print_target("x user NumPy", user / ours, 5)


def bench_frame(
    words: np.ndarray, chirp: Chirp, script: UserScript, rounds: int, rng: np.random.Generator
) -> None:
    pipeline, frame = build_pipeline(Config(), Settings(chirp=chirp)), PdmFrame(words, 7, 10**18)
    contenders: dict[str, Callable[[], object]] = {
        "ours: words to event JSON": lambda: event_json(frame, pipeline.process(frame)),
        "user script: words to image, no detection": lambda: script.image(script.audio(words)),
    }
    times = measure(contenders, rounds, rng)
    print_table("Whole frame", times, "ours: words to event JSON")
    ours, user = (times[name] for name in contenders)
    print_target("frames/s over the 27.5 Hz ceiling (min)", 1e3 / ours.min() / CEILING_HZ, 3)
    print_target(
        "frames/s over the 27.5 Hz ceiling (median)", 1e3 / np.median(ours) / CEILING_HZ, 3
    )
    print_target("x the user script", user.min() / ours.min(), 15)
    print_target(
        "99th percentile, ms (processing alone)", np.percentile(ours, 99), 36, at_most=True
    )
    heard = pipeline.process(frame)
    print(f"  {len(heard.tracks)} tracks, {heard.half_words_repaired} half-words mended")


def bench_proposals(chirp: Chirp, rounds: int, rng: np.random.Generator) -> None:
    """Detection alone, with nothing to look at and with as much as is ever looked at."""
    contenders: dict[str, Callable[[], object]] = {}
    counts = {}
    for name, words in (("empty scene", empty_words(chirp)), ("demo scene", demo_words(chirp))):
        detector = build_detector(Settings(chirp=chirp), AIR)
        decoder, audio = PdmDecoder(), np.empty((32, words.size // 10), np.float32)
        scan = detector.scan(decoder.decode(words, audio).audio)
        counts[name] = len(scan.candidates)
        contenders[name] = partial(_frame_to_detections, decoder, detector, words, audio)
    times = measure(contenders, rounds, rng)
    print_table("Frame to detections", times, "empty scene")
    print(f"  located proposals: {counts}")
    for name, least in (("empty scene", 3), ("demo scene", 1)):
        print_target(f"{name}, x the 27.5 Hz ceiling", 1e3 / times[name].min() / CEILING_HZ, least)


def _frame_to_detections(
    decoder: PdmDecoder, detector: LandmarkDetector, words: np.ndarray, audio: np.ndarray
) -> object:
    return detector.detect(decoder.decode(words, audio).audio)


def bench_stages(words: np.ndarray, chirp: Chirp, rounds: int, rng: np.random.Generator) -> None:
    scanner, pipeline, decoder = (
        scanner_for(chirp),
        build_pipeline(Config(), Settings(chirp=chirp)),
        PdmDecoder(),
    )
    frame, audio = PdmFrame(words, 7, 10**18), decoder.decode(words).audio
    _, scape = scanner.image(audio)
    heard = pipeline.process(frame)
    contenders: dict[str, Callable[[], object]] = {
        "PDM to audio": lambda: decoder.decode(words, audio),
        "  of it the search for corrupt half-words": lambda: find_corrupt_bits(words, audio),
        "matched filter and energyscape": lambda: scanner.image(audio),
        "proposals": lambda: propose(scape, max_count=12, min_snr_db=14.0),
        "image, proposals and locate": lambda: scanner.candidates(*scanner.image(audio)),
        "event JSON": lambda: event_json(frame, heard),
        "whole frame": lambda: event_json(frame, pipeline.process(frame)),
    }
    times = measure(contenders, rounds, rng)
    print_table("Stages (part of the whole)", times, "whole frame")


def bench_all(name: str, words: np.ndarray, chirp: Chirp, rounds: int) -> None:
    print(f"\n=== {name}, chirp {chirp.name}, {rounds} rounds ===")
    rng = np.random.default_rng(1)
    scanner = scanner_for(chirp)
    low, high = sorted((chirp.f_start_hz, chirp.f_stop_hz))
    azimuth_rad = scanner.image(np.zeros((32, words.size // 10), np.float32))[1].azimuth_rad
    samples = chirp.samples(AUDIO_RATE_HZ)
    script = UserScript(
        samples, (low, high), mic_positions_m(), azimuth_rad, AIR.speed_of_sound_m_s
    )
    bench_audio(words, script, rounds, rng)
    bench_image(words, scanner, script, rounds, rng)
    bench_frame(words, chirp, script, rounds, rng)
    bench_stages(words, chirp, rounds, rng)

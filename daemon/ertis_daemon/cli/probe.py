"""``ertis probe``: one sonar, and how it is."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ertis_daemon.probing import Probe
    from ertis_driver.direct_path import DirectPath

HEALTHY, WITH_FINDINGS = 0, 3
MAX_PINGS = 10_000
_WHO = {"live": "", "replay": ", a replayed recording", "sim": ", simulated"}
_NAMED_ROWS = 16
_MARKS = {"ok": ".", "stuck": "S", "interrupted": "I", "silent": "0", "twin": "=", "weak": "w"}
_MARKS["noisy"] = "N"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the flags."""
    parser.add_argument("address", help="for example serial:/dev/ttyACM0")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument(
        "--pings", type=int, default=10, metavar="N", help="active ones; default 10"
    )
    parser.add_argument(
        "--chirp", metavar="KIND:START:STOP:SECONDS", help="default hyperbolic:80000:20000:0.0025"
    )
    parser.epilog = "Exit code: 0 healthy, 3 it works but there are findings, 1 it does not work."


def run(args: argparse.Namespace) -> int:
    """Ping, and print what that tells."""
    from ertis_daemon.probe_findings import findings
    from ertis_daemon.probing import Prober
    from ertis_driver.chirp import DEFAULT_CHIRP, Chirp
    from ertis_driver.device import Settings
    from ertis_driver.errors import SettingsError
    from ertis_driver.frame import PDM_RATE_HZ
    from ertis_driver.open import open_device

    if not 1 <= args.pings <= MAX_PINGS:
        raise SettingsError(f"--pings {args.pings}, expected 1 to {MAX_PINGS}")
    chirp = Chirp.parse(args.chirp) if args.chirp else DEFAULT_CHIRP
    settings = Settings(chirp)
    listening_s = settings.num_words / PDM_RATE_HZ
    if chirp.duration_s > listening_s:
        raise SettingsError(
            f"--chirp of {chirp.duration_s:g} s, expected no more than the {listening_s:.4f} s "
            "that a ping listens"
        )
    with open_device(args.address) as sonar:
        probe = Prober(sonar, settings, args.pings).run()
    found = findings(probe)
    if args.json:
        print(json.dumps(_object(probe, found), allow_nan=False))
    else:
        print("\n".join([*_lines(probe), *_verdict(probe, found)]))
    return WITH_FINDINGS if found else HEALTHY


def _object(probe: Probe, found: list[str]) -> dict[str, Any]:
    from ertis_driver import chirp as limits
    from ertis_driver.device import MAX_NUM_WORDS, WORDS_STEP

    chirp = probe.settings.chirp
    return {
        "address": probe.info.address,
        "source": probe.info.source,
        "firmware": probe.info.firmware,
        "limits": {
            "num_words": [WORDS_STEP, MAX_NUM_WORDS],
            "num_words_step": WORDS_STEP,
            "dac_rate_hz": [limits.MIN_DAC_RATE_HZ, limits.MAX_DAC_RATE_HZ],
            "dac_samples": [limits.MIN_DAC_SAMPLES, limits.MAX_DAC_SAMPLES],
        },
        "settings": {
            "chirp": chirp.name,
            "dac_rate_hz": chirp.dac_rate_hz,
            "num_words": probe.settings.num_words,
        },
        "chirp_heard": probe.chirp_heard.name,
        "pings_asked": probe.asked,
        "active_pings_heard": len(probe.direct_paths),
        "passive_pings_heard": len(probe.half_words) - len(probe.direct_paths),
        "pings_failed": len(probe.failures),
        "pings_skipped": probe.skipped,
        "pings_per_s": probe.pings_per_s,
        "half_words_repaired": sum(probe.half_words),
        "direct_paths": [_path_object(path) for path in probe.direct_paths],
        "chirp_in_passive": probe.chirp_in_passive,
        "passive": probe.passive.to_json() if probe.passive else None,
        "active": probe.active.to_json() if probe.active else None,
        "faulty_microphones": [
            {"row": row, "state": state, "pings": count}
            for (row, state), count in sorted(probe.faults.items())
        ],
        "findings": found,
        "healthy": not found,
    }


def _path_object(path: DirectPath) -> dict[str, Any]:
    """JSON has no NaN."""
    import dataclasses
    import math

    return {
        name: None if math.isnan(value) else value
        for name, value in dataclasses.asdict(path).items()
    }


def _lines(probe: Probe) -> list[str]:
    """What was met, a topic a line."""
    rows = [
        ("sonar", f"{probe.info.address}{_WHO[probe.info.source]}"),
        ("firmware", probe.info.firmware or "none told"),
        ("limits", _limits(probe.settings.chirp.dac_rate_hz)),
        ("settings", _settings(probe)),
        ("pings", _pings(probe)),
        ("direct path", _direct_path(probe)),
        ("noise", _noise(probe)),
        ("saturated", _saturated(probe)),
        ("half-words", _half_words(probe)),
        ("microphones", _microphones(probe)),
    ]
    return [f"{name:<12} {text}" for name, text in rows]


def _limits(dac_rate_hz: int) -> str:
    from ertis_driver import chirp as limits
    from ertis_driver.device import MAX_NUM_WORDS, WORDS_STEP
    from ertis_driver.frame import PDM_RATE_HZ

    shortest_s, longest_s = WORDS_STEP / PDM_RATE_HZ, MAX_NUM_WORDS / PDM_RATE_HZ
    first_ms = limits.MIN_DAC_SAMPLES / dac_rate_hz * 1e3
    last_ms = limits.MAX_DAC_SAMPLES / dac_rate_hz * 1e3
    return (
        f"frames {shortest_s * 1e3:.1f} ms to {longest_s:.2f} s, "
        f"DAC {limits.MIN_DAC_RATE_HZ / 1e3:g} to {limits.MAX_DAC_RATE_HZ / 1e3:g} kHz, "
        f"chirps {first_ms:.2f} to {last_ms:.0f} ms at {dac_rate_hz / 1e3:g} kHz"
    )


def _settings(probe: Probe) -> str:
    from ertis_driver.frame import PDM_RATE_HZ

    chirp, num_words = probe.settings.chirp, probe.settings.num_words
    heard = "" if probe.chirp_heard == chirp else f"; recorded with {probe.chirp_heard.name}"
    return (
        f"chirp {chirp.name}, DAC {chirp.dac_rate_hz / 1e3:g} kHz, frames {num_words} words "
        f"({num_words / PDM_RATE_HZ * 1e3:.1f} ms){heard}"
    )


def _pings(probe: Probe) -> str:
    from ertis_driver.frame import PDM_RATE_HZ

    active = len(probe.direct_paths)
    text = f"{active} active, {len(probe.half_words) - active} passive"
    if probe.pings_per_s is not None:
        most = PDM_RATE_HZ / probe.settings.num_words
        text += f"; {probe.pings_per_s:.1f} a second (frames this long allow {most:.1f})"
    return text


def _direct_path(probe: Probe) -> str:
    from statistics import median

    heard = [path for path in probe.direct_paths if path.heard]
    if not heard or probe.active is None:
        return "not heard"
    delay_s, ratio = median(p.delay_s for p in heard), median(p.peak_ratio for p in heard)
    return (
        f"heard in {len(heard)} of {len(probe.direct_paths)}: after {delay_s * 1e3:.2f} ms, "
        f"level {median(probe.active.level_dbfs):.1f} dBFS, peak {ratio:.0f} times the rest"
    )


def _noise(probe: Probe) -> str:
    health = probe.passive or probe.active
    if health is None or health.usual_noise_dbfs is None:
        return "no microphone works"
    dead = ("stuck", "interrupted", "silent")
    both = zip(health.noise_dbfs, health.states, strict=True)
    working = [noise for noise, state in both if state not in dead]
    spread = f"median of {len(working)}, {min(working):.1f} to {max(working):.1f}"
    return f"{health.usual_noise_dbfs:.1f} dBFS in 20-80 kHz, {spread}"


def _saturated(probe: Probe) -> str:
    clipped = probe.active.saturated if probe.active else ()
    if not clipped:
        return "none"
    longest, last = max(c.saturated_s for c in clipped), max(c.saturated_until_s for c in clipped)
    # All 32 in a row would be longer than a line; the JSON has each of them.
    rows = ", ".join(str(channel.row) for channel in clipped)
    named = rows if len(clipped) <= _NAMED_ROWS else f"{len(clipped)} microphones"
    return f"{named}: up to {longest * 1e6:.0f} us, until {last * 1e3:.2f} ms"


def _half_words(probe: Probe) -> str:
    return f"{sum(probe.half_words)} mended in {len(probe.half_words)} pings"


def _microphones(probe: Probe) -> str:
    marks = ["."] * 32
    for row, state in probe.faults:
        marks[row] = _MARKS[state]
    groups = ["".join(marks[start : start + 8]) for start in range(0, 32, 8)]
    return f"0 {' '.join(groups)} 31   {_legend(probe)}"


def _legend(probe: Probe) -> str:
    met = sorted({state for _, state in probe.faults})
    return ", ".join(f"{_MARKS[state]} {state}" for state in ["ok", *met])


def _verdict(probe: Probe, found: list[str]) -> list[str]:
    if not found:
        return ["", "healthy"]
    number = f"{len(found)} finding{'s' * (len(found) > 1)}"
    return ["", *(f"- {line}" for line in found), "", f"works, with {number}"]

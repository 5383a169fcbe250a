"""What is wrong with a sonar, in one line each, each with what to do."""

from __future__ import annotations

from ertis_daemon.probing import Probe
from ertis_driver.direct_path import FORWARD_DB
from ertis_driver.geometry import mic_positions_m
from ertis_driver.health import ChannelState

# 20 dB over the usual -55 dBFS: compressed air, or bits that no microphone made.
LOUD_DBFS = -35.0

_MEANINGS: dict[ChannelState, str] = {
    "stuck": "its bit never changes: look at its data line and solder joints",
    "interrupted": "its bit stands still at times: look for a loose contact",
    "silent": "bits without a microphone's noise: look at its supply and clock",
    "weak": "10 dB below the others: look for dirt in its port",
    "noisy": "10 dB noisier than the others: look at its supply, or for a leak of air near it",
}


def mic_name(row: int) -> str:
    """A microphone by row and place, seen from the centre of the array.

    >>> mic_name(16)
    'microphone 16 (7 mm left, 19 mm below)'
    """
    _, left_m, up_m = mic_positions_m()[row]
    side = f"{abs(left_m) * 1e3:.0f} mm {'left' if left_m >= 0 else 'right'}"
    return (
        f"microphone {row} ({side}, {abs(up_m) * 1e3:.0f} mm {'above' if up_m >= 0 else 'below'})"
    )


def findings(probe: Probe) -> list[str]:
    """What a healthy sonar would not have; empty for a healthy one."""
    heard = len(probe.half_words)
    found = []
    if probe.failures:
        asked = heard + len(probe.failures)
        found.append(f"{len(probe.failures)} of {asked} pings failed: {probe.failures[-1]}")
    if probe.skipped:
        found.append(
            f"the ping counter passed over {probe.skipped}: another client, or lost frames"
        )
    found += _of_direct_path(probe)
    for (row, state), count in sorted(probe.faults.items()):
        found.append(f"{mic_name(row)}: {_meaning(probe, row, state)}; in {count} of {heard} pings")
    for row, count in sorted(probe.late_saturation.items()):
        found.append(
            f"{mic_name(row)}: saturated when no direct path explains it, in {count} of {heard} "
            "pings: look for a blast of air, a knock, or an object in front of it"
        )
    noise = [h.usual_noise_dbfs for h in (probe.passive, probe.active) if h is not None]
    loudest = max((value for value in noise if value is not None), default=LOUD_DBFS)
    if loudest > LOUD_DBFS:
        found.append(
            f"noise {loudest:.1f} dBFS, expected below {LOUD_DBFS:g}: look for compressed air; if "
            "there is none, these are no microphones' bits"
        )
    return found


def _of_direct_path(probe: Probe) -> list[str]:
    found = []
    count = len(probe.direct_paths)
    backward = sum(path.level_over_reversed_db < -FORWARD_DB for path in probe.direct_paths)
    deaf = sum(not path.heard for path in probe.direct_paths) - backward
    if backward:
        found.append(
            f"the chirp came backward in {backward} of {count} active pings: the device kept an "
            "older one; configure it again, replug it if that persists"
        )
    if deaf:
        found.append(
            f"no direct path in {deaf} of {count} active pings: the chirp was not emitted; look at "
            "emitter and amplifier, and try the other trigger form"
        )
    if probe.chirp_in_passive:
        found.append(
            "the passive ping heard a chirp: try the other trigger form"
            + ("" if probe.info.source == "live" else ", unless a recording is played")
        )
    return found


def _meaning(probe: Probe, row: int, state: ChannelState) -> str:
    if state != "twin":
        return f"{state}: {_MEANINGS[state]}"
    health = probe.active or probe.passive
    other = health.twins.get(row) if health else None
    same = "another" if other is None else str(other)
    return f"twin: the bits of microphone {same}: look at their select pins and shared data line"

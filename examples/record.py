"""Record what a sonar hears somewhere on the network; the daemon needs ``zenoh.raw: true``.

``python record.py DEVICE OUT.mcap SECONDS [LOCATOR]``. The recording is one like any other: replay
it, detect in it, train with it.
"""

import json
import sys
import time
from pathlib import Path

import zenoh

from ertis_driver.chirp import Chirp
from ertis_driver.frame import PdmFrame
from ertis_driver.protocol import decode_frame
from ertis_driver.recording import RecordingInfo, RecordingWriter


def ask(session: zenoh.Session, key: str) -> dict:
    """What a daemon answers on a key; ends the program if there is none."""
    for reply in session.get(key, timeout=3.0):
        if reply.ok:
            return json.loads(reply.ok.payload.to_bytes())
    raise SystemExit(f"nobody answers on {key}: is the daemon running?")


def describe(session: zenoh.Session, device: str) -> RecordingInfo:
    """Who makes the frames, and how."""
    info, config = (ask(session, f"ertis/{device}/{name}") for name in ("info", "config"))
    chirp = Chirp(**config["chirp"])
    if chirp.name != info["chirp"]:
        raise SystemExit(f"{device} plays a recording with another chirp: copy that instead")
    return RecordingInfo(
        source=info["source"],
        chirp=chirp,
        num_words=info["num_words"],
        temperature_c=config["temperature_c"],
        humidity_percent=config["humidity_percent"],
        firmware=info["firmware"],
        address=info["address"],
    )


def main(device: str, out: str, seconds: float, locators: list[str]) -> None:
    """Record for some seconds."""
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps(locators or ["tcp/localhost:7447"]))
    with zenoh.open(config) as session, RecordingWriter(out, describe(session, device)) as writer:
        frames = zenoh.handlers.RingChannel(8)  # the oldest go if the disk is too slow
        subscriber = session.declare_subscriber(f"ertis/{device}/raw", frames)
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            sample = subscriber.try_recv()
            if sample is None:
                time.sleep(0.005)
                continue
            raw = decode_frame(sample.payload.to_bytes())
            writer.write(PdmFrame(raw.words, **json.loads(sample.attachment.to_bytes())))
    if not writer.pings_written:
        Path(out).unlink()
        raise SystemExit(f"no ping of {device} in {seconds:g} s: the daemon needs zenoh.raw: true")
    print(f"{writer.pings_written} pings of {device} in {out}")


if __name__ == "__main__":
    if len(sys.argv) < 4:
        raise SystemExit("usage: python record.py DEVICE OUT.mcap SECONDS [LOCATOR]")
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4:])

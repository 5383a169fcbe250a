"""The daemon for a long time: does it grow, how late are its events, what does it cost?

``python tests/bench/soak.py --minutes 30 --rate 27.5`` pings at a set rate; ``--pings 100000`` as
fast as it goes. Emulator, daemon and this reader are three processes. Prints a table, writes one
sample a second to ``out/soak.jsonl``, and draws ``out/soak.png``. Ctrl-C ends it early and tells so
far; ``--draw out/soak.jsonl`` tells it again. A slow or busy machine shows in the figures, and
makes nothing fail.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from soak_report import draw, summarize
from soak_rig import Daemon, Emulated, Subscriber, machine, simulate


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pings", type=int, default=0, help="end after so many")
    parser.add_argument("--minutes", type=float, default=0.0, help="end after so long")
    parser.add_argument("--rate", type=float, default=0.0, help="pings a second; 0: all it can")
    parser.add_argument("--num-words", type=int, default=163_840, help="of each frame")
    parser.add_argument("--recording", type=Path, help="what the sonar plays; else simulated")
    parser.add_argument("--out", type=Path, default=Path("out/soak.jsonl"))
    parser.add_argument("--draw", type=Path, metavar="JSONL", help="run nothing, tell of that run")
    args = parser.parse_args()
    if args.draw is None:
        if not (args.pings or args.minutes):
            args.pings = 3000
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        args.out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder, suppress(KeyboardInterrupt):
            run(Path(folder), args)
    path = args.draw or args.out
    about, *samples = map(json.loads, path.read_text().splitlines() or ["null"])
    if about is None:
        sys.exit(f"{path} is empty: it ended before the daemon was ready")
    print(summarize(about, samples))
    draw(about, samples, path.with_suffix(".png"))
    print(f"samples in {path}, drawn in {path.with_suffix('.png')}")


def run(folder: Path, args: argparse.Namespace) -> None:
    """Start all and take samples until it is over."""
    recording = args.recording or simulate(folder / "sim.mcap", args.num_words)
    with ExitStack() as stack:
        out = stack.enter_context(args.out.open("w"))
        emulated = Emulated(stack, recording)
        about = {"rate_hz": args.rate, "floor": emulated.floor(args.num_words, args.rate)}
        daemon = Daemon(stack, folder, emulated.port, args.rate, args.num_words)
        about["ready_s"] = daemon.ready_s
        out.write(json.dumps(about) + "\n")
        subscriber = Subscriber(stack, daemon.locator)
        start_s = due_s = time.monotonic()
        while daemon.is_running:
            due_s = max(due_s + 1.0, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic() - start_s
            status = subscriber.status()
            sample = {"t_s": now_s, **machine(), **daemon.usage(), **status}
            sample["heard"] = subscriber.take(daemon.take_latencies())
            out.write(json.dumps(sample) + "\n")
            out.flush()
            if args.pings and status.get("pings_heard", 0) >= args.pings:
                return
            if args.minutes and now_s >= 60 * args.minutes:
                return
        print(f"the daemon ended by itself:\n{daemon.last_words()}")


if __name__ == "__main__":
    main()

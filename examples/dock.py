"""Drive up to a landmark: from events to the velocities of a robot with two wheels.

``python dock.py SIZE [LOCATOR]``, where SIZE is the landmark's class, such as r58. Each line is a
command: v forward, m/s; w to the left, rad/s. Give them to your base instead of printing them.
"""

import json
import sys
import time

import zenoh

STOP_AT_M = 0.4  # from the sonar to the dish
STALE_S = 1.0  # a landmark not heard for so long is nothing to drive at
MIN_PROBABILITY = 0.5
V_MAX_M_S, W_MAX_RAD_S = 0.3, 0.6


def newest(subscriber: zenoh.Subscriber, size: str) -> dict | None:
    """The landmark of that size in the last event that waits; None if there is none."""
    found = None
    while (sample := subscriber.try_recv()) is not None:
        for mark in json.loads(sample.payload.to_bytes())["landmarks"]:
            is_it = mark["class"] == size and mark["state"] != "lost"
            known = mark["range_m"] is not None and mark["azimuth_rad"] is not None
            if is_it and known and (mark["probabilities"].get(size) or 0) >= MIN_PROBABILITY:
                found = mark
    return found


def velocities(range_m: float, azimuth_rad: float) -> tuple[float, float]:
    """Turn towards it, and approach the slower the nearer, and the more it lies aside."""
    w = max(-W_MAX_RAD_S, min(W_MAX_RAD_S, 1.5 * azimuth_rad))
    v = max(0.0, min(V_MAX_M_S, 0.5 * (range_m - STOP_AT_M)))
    return v * max(0.0, 1.0 - abs(azimuth_rad) / 0.5), w


def main(size: str, locators: list[str]) -> None:
    """Command until the landmark is reached; stand still while it is not heard."""
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps(locators or ["tcp/localhost:7447"]))
    with zenoh.open(config) as session:
        key = "ertis/*/landmarks"
        subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(16))
        heard_s = float("-inf")
        while True:
            time.sleep(0.05)
            mark = newest(subscriber, size)
            if mark is not None:
                heard_s = time.monotonic()
                reached = mark["range_m"] <= STOP_AT_M
                v, w = velocities(mark["range_m"], mark["azimuth_rad"])
                if reached:
                    v = w = 0.0
                told = {"v": round(v, 3), "w": round(w, 3), "range_m": mark["range_m"]}
                print(json.dumps(told | {"reached": reached}), flush=True)
                if reached:
                    return
            elif time.monotonic() - heard_s > STALE_S:
                print(json.dumps({"v": 0.0, "w": 0.0}), flush=True)
                time.sleep(0.2)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit("usage: python dock.py SIZE [LOCATOR]")
    main(sys.argv[1], sys.argv[2:])

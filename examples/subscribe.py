"""Print what sonars hear. Plain Zenoh, nothing of ours: ``pip install eclipse-zenoh``.

``python subscribe.py [LOCATOR]``, by default tcp/localhost:7447.
"""

import json
import math
import sys

import zenoh

config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:] or ["tcp/localhost:7447"]))
with zenoh.open(config) as session:
    subscriber = session.declare_subscriber("ertis/*/landmarks")
    for sample in subscriber:
        event = json.loads(sample.payload.to_bytes())
        for mark in event["landmarks"]:
            bearing = math.degrees(mark["azimuth_rad"] or math.nan)
            print(event["device"], mark["class"], f"{mark['range_m']:.2f} m", f"{bearing:+.0f} deg",
                  mark["state"], event["source"], flush=True)  # fmt: skip

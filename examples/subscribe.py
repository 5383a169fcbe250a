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
            place = mark["range_m"], mark["azimuth_rad"]  # null where it could not be told
            range_m, azimuth = (math.nan if one is None else one for one in place)
            where = f"{range_m:.2f} m {math.degrees(azimuth):+.0f} deg"
            print(event["device"], mark["class"], where, mark["state"], event["source"], flush=True)

"""Well-formed inputs for the fuzzer to begin with."""

import io
import json

import numpy as np
from mcap.writer import CompressionType, Writer

from ertis_driver.chirp import INCUMBENT_CHIRP
from ertis_driver.protocol import encode_frame
from ertis_driver.recording_info import RecordingInfo, to_strings

FRAME = encode_frame(7, np.arange(1, dtype=np.uint32))
COMMANDS = (
    b"!Y,0,0,0\n!G,131072,0,0\n!F,1,0,0\n!D,450000,0,0\n!E,64,0,0\n!C,0,4095,0\n!L,0,0,0\n!I,1,0,0\n",
    b"!J,1,2,0,0\n!J,1,1,0\n!H,1,0,0\n!K,1,0,0\n!B,4294967295,0,0\n!G,131072,0,0\n!A,1,0,0\n",
    b"!G,131072,0,0\n!A,0,0,0!A,1,0,0!L,0,0,0\n",
)


def recording(compression, truth=b'{"landmarks": []}'):
    """A recording of one ping of one word, without checksums: those would stop the fuzzer."""
    file = io.BytesIO()
    writer = Writer(file, compression=compression, enable_crcs=False, enable_data_crcs=False)
    writer.start(profile="", library="ertis")
    writer.add_metadata("ertis", to_strings(RecordingInfo("sim", INCUMBENT_CHIRP, 1, 21.5)))
    about = {"ping_index": 7, "active": True, "time_uncertainty_ns": 5, "clock_step_ns": 0}
    about["temperature_c"] = None
    messages = {"ping": json.dumps(about).encode(), "truth": truth, "pdm": FRAME}
    for topic, data in messages.items():
        schema = writer.register_schema(topic, "text", b"")
        channel = writer.register_channel(topic, "json", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=data)
    writer.finish()
    return file.getvalue()


def seeds(target):
    """Inputs for one target."""
    if target == "parser":  # 0xFE and 0xFF stand for header and footer; eight bytes of cuts before
        return [bytes(range(0, 80, 10)) + b"\xfe" + bytes(8) + b"\xff" + b"noise\xfe\xff"]
    if target == "firmware":
        return [b"\x00\x40" + lines for lines in COMMANDS] + [b"\xf0\x05" + COMMANDS[-1]]
    if target == "frame":
        return [FRAME, b"\xff" + FRAME[4:-4]]
    if target == "mcap":
        return [recording(kind) for kind in CompressionType]
    if target == "raw":
        return [(655_360).to_bytes(3, "little") + b"ab", b"RIFF"]
    return []

"""What is fuzzed, and what must hold of it. Imported under instrumentation by ``fuzz``."""

import tempfile
from pathlib import Path

import numpy as np
import planted
from frame_spec import as_pairs, feed_in_pieces, frames_in

from ertis_driver import protocol
from ertis_driver.errors import FrameCorrupt, RecordingError, SettingsError
from ertis_driver.firmware import FirmwareState
from ertis_driver.frame_parser import FrameParser
from ertis_driver.recording import open_recording

MAX_ANSWERED_WORDS = 65_536  # a longer frame only takes time

VERSION = protocol.encode_reply(protocol.encode_version("2.3.4", "sim"))


def parser(data):
    """Any stream, cut anywhere: the frames that stand whole in it, and all bytes accounted for."""
    plan, stream = data[:8], data[8:]
    if len(plan) < 8:
        return
    num_words = 1 + plan[0] % 8
    whole = protocol.frame_bytes(num_words)
    # A fuzzer does not find eight bytes of framing by itself: 0xFE and 0xFF stand for them.
    stream = stream.replace(b"\xfe", protocol.HEADER_BYTES).replace(b"\xff", protocol.FOOTER_BYTES)
    frames = FrameParser(num_words)
    found = feed_in_pieces(frames, stream, [cut * len(stream) // 256 for cut in plan[1:]])
    assert as_pairs(found) == frames_in(stream, num_words)
    assert frames.bytes_lost + frames.pending_bytes + whole * len(found) == len(stream)
    frames.clear()
    assert frames.pending_bytes == 0


class Silence:
    """Frames of zeros, and none where that would take long."""

    def next_frame(self, request):
        if request.num_words > MAX_ANSWERED_WORDS:
            raise SettingsError("too long to play with")
        return np.zeros(request.num_words, np.uint32)


def firmware(data):
    """Any commands, cut anywhere: the same reply words and frames; a client finds it alive."""
    form = "windows" if data[:1] > b"\x7f" else "linux"
    state, uncut = (FirmwareState(Silence(), trigger_form=form) for _ in range(2))
    at = 2 + (data[1] if len(data) > 1 else 0)
    replies = state.feed(data[2:at]) + state.feed(data[at:])
    for reply in replies:
        assert len(reply) == protocol.REPLY_BYTES or protocol.decode_frame(reply)
    assert replies == uncut.feed(data[2:])
    assert state.feed(b"\n!Y,0,0,0\n")[-1:] == [VERSION]
    for pin in (1, 2):
        triggered = state.trigger(pin)
        assert triggered is None or protocol.decode_frame(triggered)


def frame(data):
    """Any bytes are one frame, which encodes to the same, or ``FrameCorrupt``."""
    if data[:1] == b"\xff":
        data = protocol.HEADER_BYTES + data[1:] + protocol.FOOTER_BYTES
    try:
        found = protocol.decode_frame(data)
    except FrameCorrupt:
        return
    assert protocol.encode_frame(found.index, found.words) == data


def read_all(data, name):
    """Read the data as a recording; what is wrong with it is one line of ``RecordingError``."""
    path = Path(tempfile.gettempdir()) / name
    path.write_bytes(data)
    message = ""
    try:
        for ping in open_recording(path):
            assert ping.frame.words.dtype == np.uint32
    except RecordingError as error:
        message = str(error)
    finally:
        path.unlink()
    assert "\n" not in message


def mcap(data):
    """Any bytes as an MCAP recording."""
    read_all(data, "fuzzed.mcap")


def raw(data):
    """Any bytes, repeated to any length, as a headerless recording."""
    count = int.from_bytes(data[:3], "little") % 700_000
    content = (data[3:] * (count // max(1, len(data) - 3) + 1))[:count] if len(data) > 3 else b""
    read_all(content, "fuzzed.bin")


TARGETS = {
    "parser": parser,
    "firmware": firmware,
    "frame": frame,
    "mcap": mcap,
    "raw": raw,
    "planted": planted.check,
}

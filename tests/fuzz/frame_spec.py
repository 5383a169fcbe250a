"""What a frame parser must find, said in the simplest way: slow, whole stream at once."""

from ertis_driver.ping_counter import GAP_ALLOWANCE
from ertis_driver.protocol import FOOTER_BYTES, HEADER_BYTES, decode_reply, frame_bytes


def frames_in(stream, num_words):
    """All ``(index, words as bytes)`` between a header and a footer at the right distance.

    None in which a later frame begins: that one was cut short. The search goes on behind a frame,
    and one byte behind a header that is not believed.
    """
    size = frame_bytes(num_words)
    found, start = [], 0
    while start + size <= len(stream):
        frame = stream[start : start + size]
        framed = frame.startswith(HEADER_BYTES) and frame.endswith(FOOTER_BYTES)
        if framed and not later_frame_begins_in(frame):
            found.append((decode_reply(frame[4:8]), frame[8:-4]))
            start += size
        else:
            start += 1
    return found


def later_frame_begins_in(frame):
    """Whether a header with an index that may follow stands somewhere behind the frame's own."""
    index = decode_reply(frame[4:8])
    return any(
        frame.startswith(HEADER_BYTES, at)
        and 0 < (decode_reply(frame[at + 4 : at + 8]) - index) % 2**32 <= GAP_ALLOWANCE
        for at in range(4, len(frame) - 7)
    )


def as_pairs(frames):
    """The same for what a parser found."""
    return [(frame.index, frame.words.astype("<u4").tobytes()) for frame in frames]


def feed_in_pieces(parser, stream, cuts):
    """Feed a stream that is cut at these places; return the frames."""
    points = sorted(min(cut, len(stream)) for cut in cuts)
    ends = [*points, len(stream)]
    return [
        frame
        for start, end in zip([0, *points], ends, strict=True)
        for frame in parser.feed(stream[start:end])
    ]

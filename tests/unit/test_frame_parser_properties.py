"""What the parser promises of any stream, and on which assumption.

The wire has no checksum, so three things bound what any parser can promise:

- Of any bytes at all: each frame delivered stands whole in what was received, between a header
  and a footer at the right distance, and no later one begins in it; all bytes are accounted for;
  where the stream was cut is of no importance.
- No frame is delivered that was not sent, and only frames hit by the damage are lost, if payloads
  hold neither header nor footer (a random payload holds both at the one harmful distance once in
  2**64 places) and what is lost and gained does not add up to a whole frame, or to nothing within
  one. If payloads may hold headers, the damage costs the frame that it hits and at most one more.
- A byte changed inside index or words cannot be seen at all.
"""

import pytest
from frame_spec import as_pairs, feed_in_pieces, frames_in
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver import frame_parser
from ertis_driver.frame_parser import FrameParser
from ertis_driver.protocol import FOOTER_BYTES, HEADER_BYTES, frame_bytes

NUM_WORDS = 16
SIZE = frame_bytes(NUM_WORDS)
INSIDE = SIZE - len(HEADER_BYTES) - len(FOOTER_BYTES)  # index and words
# Neither header nor footer can begin in what this leaves.
PLAIN = bytes(0 if byte in (HEADER_BYTES[0], FOOTER_BYTES[0]) else byte for byte in range(256))
INDEX_TOP = (0x7F, 0x55, 0x7F)  # no payload holds a following index by chance
MAX_SHIFT = 12  # three damages of it stay below one frame

cuts = st.lists(st.integers(0, 8 * SIZE), max_size=12)
any_bytes = st.binary(min_size=INSIDE, max_size=INSIDE)
plain_bytes = any_bytes.map(lambda inside: inside.translate(PLAIN))
any_frames = any_bytes.map(lambda inside: HEADER_BYTES + inside + FOOTER_BYTES)
plain_frames = plain_bytes.map(lambda inside: HEADER_BYTES + inside + FOOTER_BYTES)


def numbered(frames, count):
    """So many frames in a row, each with its place as its index."""
    return st.lists(frames, min_size=count, max_size=count).map(
        lambda sent: [
            frame[:4] + bytes([number, *INDEX_TOP]) + frame[8:] for number, frame in enumerate(sent)
        ]
    )


def pairs(frames):
    return [pair for frame in frames for pair in frames_in(frame, NUM_WORDS)]


@st.composite
def frames_with_headers_inside(draw):
    inside = bytearray(draw(plain_bytes))
    for at in draw(st.lists(st.integers(4, INSIDE - 4), max_size=4)):
        inside[at : at + 4] = HEADER_BYTES
    return HEADER_BYTES + bytes(inside) + FOOTER_BYTES


@st.composite
def frames_with_a_beginning_inside(draw):
    inside = bytearray(draw(any_bytes))
    at = draw(st.integers(4, INSIDE - 8))
    inside[at : at + 4] = HEADER_BYTES
    following = int.from_bytes(inside[:4], "little") + draw(st.integers(-2, 3))
    inside[at + 4 : at + 8] = (following % 2**32).to_bytes(4, "little")
    return HEADER_BYTES + bytes(inside) + FOOTER_BYTES


@st.composite
def hostile_streams(draw):
    """Frames, parts of frames, header and footer words, and noise, in any order."""
    part = st.one_of(
        any_frames,
        frames_with_headers_inside(),
        frames_with_a_beginning_inside(),
        any_frames.flatmap(lambda frame: st.integers(0, SIZE).map(lambda end: frame[:end])),
        any_frames.flatmap(lambda frame: st.integers(0, SIZE).map(lambda start: frame[start:])),
        st.sampled_from([HEADER_BYTES, FOOTER_BYTES]),
        st.binary(max_size=2 * SIZE),
    )
    return b"".join(draw(st.lists(part, max_size=7)))


@st.composite
def damages(draw, frame_number):
    """One damage that begins in this frame: ``(start, end, what stands there instead, kind)``."""
    begin = frame_number * SIZE
    start = begin + draw(st.integers(0, SIZE - 1))
    length = draw(st.integers(1, MAX_SHIFT))
    kind = draw(st.sampled_from(["lost", "doubled", "inserted", "flipped"]))
    if kind == "flipped":  # where it can be seen: in header or footer
        at = begin + draw(st.sampled_from([0, 1, 2, 3, SIZE - 4, SIZE - 3, SIZE - 2, SIZE - 1]))
        return at, at + 1, None, kind
    if kind == "inserted":
        noise = draw(st.binary(min_size=length, max_size=length))
        return start, start, noise.translate(PLAIN), kind
    return start, start + length, b"", kind


def apply(stream, damage, flip):
    """The damaged stream, and the numbers of the frames that are no longer whole in it."""
    start, end, instead, kind = damage
    if kind == "doubled":
        end = min(end, len(stream))
        number, inside = divmod(end, SIZE)
        # What is doubled from a frame's first byte on stands before the whole frame.
        hit = {number} if inside and start > number * SIZE else set()
        return stream[:end] + stream[start:], hit
    if kind == "inserted":
        hit = {start // SIZE} if start % SIZE else set()
    else:
        end = min(end, len(stream))
        hit = {start // SIZE, (end - 1) // SIZE}
    if kind == "flipped":
        instead = bytes([stream[start] ^ flip])
    return stream[:start] + instead + stream[end:], hit


@given(hostile_streams(), cuts)
def test_any_stream_cut_anywhere_gives_the_frames_that_stand_whole_in_it(stream, cuts):
    parser = FrameParser(NUM_WORDS)
    found = feed_in_pieces(parser, stream, cuts)
    assert as_pairs(found) == frames_in(stream, NUM_WORDS)
    assert parser.bytes_lost + parser.pending_bytes + SIZE * len(found) == len(stream)
    assert parser.pending_bytes < SIZE


@given(hostile_streams(), st.integers(0, 8 * SIZE), st.lists(any_frames, max_size=2))
def test_after_clear_nothing_of_before_is_left_but_the_count(stream, at, sent):
    parser = FrameParser(NUM_WORDS)
    before = parser.feed(stream[:at])
    parser.clear()
    assert parser.pending_bytes == 0
    assert parser.bytes_lost == len(stream[:at]) - SIZE * len(before)
    assert as_pairs(parser.feed(b"".join(sent))) == pairs(sent)


@given(numbered(plain_frames, 6), st.data())
def test_damage_costs_only_the_frames_that_it_hits(sent, data):
    stream, hit = b"".join(sent), set()
    for number in (4, 2, 0):  # from the end on, so that the numbers stay right
        if data.draw(st.booleans()):
            damage = data.draw(damages(number))
            stream, touched = apply(stream, damage, data.draw(st.integers(1, 255)))
            hit |= touched
    parser = FrameParser(NUM_WORDS)
    found = feed_in_pieces(parser, stream, data.draw(cuts))
    assert as_pairs(found) == pairs([one for number, one in enumerate(sent) if number not in hit])
    assert parser.bytes_lost + parser.pending_bytes == len(stream) - SIZE * len(found)


@given(numbered(frames_with_headers_inside(), 5), st.data())
def test_with_headers_in_the_payload_damage_costs_one_frame_more_at_most(sent, data):
    number = data.draw(st.integers(0, 3))
    stream, hit = apply(b"".join(sent), data.draw(damages(number)), data.draw(st.integers(1, 255)))
    found = as_pairs(feed_in_pieces(FrameParser(NUM_WORDS), stream, data.draw(cuts)))
    whole = pairs(sent)
    lost = {at for at, one in enumerate(whole) if one not in found}
    assert hit <= lost <= {*hit, max(hit, default=-1) + 1}
    assert [one for one in found if one in whole] == [
        one for at, one in enumerate(whole) if at not in lost
    ]


@given(plain_frames, plain_frames, st.integers(4, SIZE - 5), st.integers(1, 255))
def test_a_byte_changed_in_index_or_words_is_not_seen(first, second, at, flip):
    changed = bytearray(first)
    changed[at] ^= flip
    parser = FrameParser(NUM_WORDS)
    found = as_pairs(parser.feed(bytes(changed) + second))
    assert found == [*frames_in(bytes(changed), NUM_WORDS), *pairs([second])]
    assert parser.bytes_lost == 0


@given(plain_frames, plain_frames, st.integers(4, SIZE - 4))
def test_a_loss_of_exactly_one_frames_length_is_seen_only_by_the_index(first, second, at):
    # The head of one frame and the tail of the next make a whole one: the counter has jumped.
    spliced = first[:at] + second[at:]
    assert as_pairs(FrameParser(NUM_WORDS).feed(spliced)) == frames_in(spliced, NUM_WORDS)


def test_a_hostile_payload_can_pass_for_a_frame_but_not_when_the_stream_is_whole():
    shift = 8
    inside = bytearray(INSIDE)
    inside[INSIDE - shift : INSIDE - shift + 4] = FOOTER_BYTES
    hostile = HEADER_BYTES + bytes(inside) + FOOTER_BYTES
    assert as_pairs(FrameParser(NUM_WORDS).feed(hostile + hostile)) == pairs([hostile, hostile])
    with_insertion = hostile[:20] + bytes(shift) + hostile[20:]
    delivered = FrameParser(NUM_WORDS).feed(with_insertion)
    assert len(delivered) == 1
    assert as_pairs(delivered) != pairs([hostile])


class CountingBytearray(bytearray):
    """Counts the bytes that are searched, read or moved."""

    touched = 0

    def find(self, pattern, start, end):
        at = super().find(pattern, start, end)
        CountingBytearray.touched += (at if at >= 0 else end) - start + len(pattern)
        return at

    def __getitem__(self, key):
        part = super().__getitem__(key)
        CountingBytearray.touched += len(part)
        return part

    def __setitem__(self, key, value):
        CountingBytearray.touched += len(value)
        super().__setitem__(key, value)


@pytest.mark.parametrize("content", ["frames", "headers", "no headers", "one frame, no footer"])
@pytest.mark.parametrize("piece", [1, 7, 64, 10**6])
def test_the_work_is_linear_however_finely_the_stream_is_cut(monkeypatch, content, piece):
    monkeypatch.setattr(frame_parser, "bytearray", CountingBytearray, raising=False)
    num_words = 2048
    frame = HEADER_BYTES + bytes(frame_bytes(num_words) - 8) + FOOTER_BYTES
    stream = {
        "frames": 4 * frame,
        "headers": HEADER_BYTES * len(frame),
        "no headers": bytes(4 * len(frame)),
        "one frame, no footer": frame[:-4] + bytes(3 * len(frame)),
    }[content]
    holds_header = frame_parser._holds_header

    def counted(data):
        CountingBytearray.touched += len(data)
        return holds_header(data)

    monkeypatch.setattr(frame_parser, "_holds_header", counted)
    CountingBytearray.touched = 0
    parser = FrameParser(num_words)
    for start in range(0, len(stream), piece):
        parser.feed(stream[start : start + piece])
    # Searched, looked at for a footer, perhaps once to the front; and a few for each piece.
    assert len(frame) <= CountingBytearray.touched < 5 * len(stream) + 20 * (len(stream) / piece)

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver import protocol
from ertis_driver.errors import FrameCorrupt, SettingsError, WrongDevice
from ertis_driver.frame_parser import FrameParser
from ertis_driver.protocol import FOOTER, HEADER, HEADER_BYTES, encode_frame

NUM_WORDS = 6
words_lists = st.lists(
    # Header and footer words inside the payload are what a careless parser trips over.
    st.sampled_from([HEADER, FOOTER, 0, 0xFFFFFFFF]) | st.integers(0, 2**32 - 1),
    min_size=NUM_WORDS,
    max_size=NUM_WORDS,
)
frames = st.tuples(st.integers(0, 2**32 - 1), words_lists)
# No header in it: one in front of a true frame hides that until more bytes come; tested apart.
garbage = st.binary(max_size=60).filter(lambda data: b"\x12" not in data)


def as_bytes(frame):
    index, words = frame
    return encode_frame(index, np.array(words, np.uint32))


def cut(data, cuts):
    points = sorted(min(point, len(data)) for point in cuts)
    return [data[a:b] for a, b in zip([0, *points], [*points, len(data)], strict=True)]


def feed_all(parser, pieces):
    return [frame for piece in pieces for frame in parser.feed(piece)]


def simple(found):
    return [(frame.index, frame.words.tolist()) for frame in found]


@given(st.lists(frames, max_size=4), st.lists(st.integers(0, 150), max_size=8))
def test_a_stream_cut_anywhere_gives_the_same_frames(sent, cuts):
    parser = FrameParser(NUM_WORDS)
    found = feed_all(parser, cut(b"".join(map(as_bytes, sent)), cuts))
    assert simple(found) == sent
    assert (parser.bytes_lost, parser.frames_corrupt, parser.pending_bytes) == (0, 0, 0)


@given(st.lists(st.tuples(garbage, frames), min_size=1, max_size=4), st.data())
def test_garbage_between_frames_is_counted_and_costs_none(sent, data):
    stream = b"".join(noise + as_bytes(frame) for noise, frame in sent)
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=8))
    parser = FrameParser(NUM_WORDS)
    assert simple(feed_all(parser, cut(stream, cuts))) == [frame for _, frame in sent]
    assert parser.bytes_lost == sum(len(noise) for noise, _ in sent)
    assert parser.frames_corrupt == 0


plain = st.tuples(
    st.integers(0, 2**24), st.lists(st.just(0x01010101), min_size=NUM_WORDS, max_size=NUM_WORDS)
).filter(lambda frame: HEADER_BYTES[:1] not in frame[0].to_bytes(4, "little"))


@given(plain, plain, st.integers(0, 3), st.integers(1, 255))
def test_a_wrong_footer_drops_its_frame_and_not_the_next(bad, good, at, flip):
    damaged = bytearray(as_bytes(bad))
    damaged[-4 + at] ^= flip
    if HEADER_BYTES[0] in damaged[-4:]:
        return
    parser = FrameParser(NUM_WORDS)
    assert simple(parser.feed(bytes(damaged) + as_bytes(good))) == [good]
    assert parser.frames_corrupt == 1
    assert parser.bytes_lost == len(damaged)


@given(plain, plain, st.integers(1, 4 * NUM_WORDS), st.integers(0, 40))
def test_a_frame_with_bytes_missing_costs_only_itself(bad, good, missing, start):
    whole = as_bytes(bad)
    start = 4 + min(start, len(whole) - 4 - missing)
    short = whole[:start] + whole[start + missing :]
    parser = FrameParser(NUM_WORDS)
    found = simple(parser.feed(short + as_bytes(good) + bytes(40)))
    assert found == [good]
    assert parser.frames_corrupt == 1


@given(plain, st.integers(1, 30))
def test_a_false_header_in_front_of_a_frame_does_not_hide_it(sent, distance):
    parser = FrameParser(NUM_WORDS)
    found = simple(parser.feed(HEADER_BYTES + bytes(distance) + as_bytes(sent) + bytes(80)))
    assert sent in found


@given(st.lists(st.binary(max_size=200) | frames.map(as_bytes), max_size=12))
def test_every_byte_is_a_frame_or_lost_or_pending(pieces):
    parser = FrameParser(NUM_WORDS)
    found = feed_all(parser, pieces)
    total = sum(map(len, pieces))
    in_frames = len(found) * protocol.frame_bytes(NUM_WORDS)
    assert in_frames + parser.bytes_lost + parser.pending_bytes == total


def test_nothing_but_headers_neither_hangs_nor_gives_frames():
    parser = FrameParser(4096)
    assert parser.feed(HEADER_BYTES * 20_000) == []


def test_a_default_frame_in_tty_sized_pieces_comes_out_whole():
    words = np.random.default_rng(1).integers(0, 2**32, 163_840, dtype=np.uint32)
    data = encode_frame(2**32 - 1, words)
    assert len(data) == 655_372
    parser = FrameParser(163_840)
    (frame,) = feed_all(parser, [data[i : i + 4095] for i in range(0, len(data), 4095)])
    assert frame.index == 2**32 - 1
    np.testing.assert_array_equal(frame.words, words)
    assert frame.words.dtype == np.uint32


def test_a_frame_stays_as_it_was_while_the_next_ones_come():
    parser = FrameParser(NUM_WORDS)
    (first,) = parser.feed(encode_frame(1, np.full(NUM_WORDS, 7, np.uint32)))
    for index in range(5):
        parser.feed(encode_frame(index, np.zeros(NUM_WORDS, np.uint32)))
    assert first.words.tolist() == [7] * NUM_WORDS


def test_clear_forgets_half_a_frame():
    parser = FrameParser(NUM_WORDS)
    data = encode_frame(3, np.zeros(NUM_WORDS, np.uint32))
    parser.feed(data[:20])
    assert parser.clear() == 20
    assert [frame.index for frame in parser.feed(data)] == [3]


@given(frames)
def test_a_frame_decodes_to_what_was_encoded(sent):
    frame = protocol.decode_frame(as_bytes(sent))
    assert (frame.index, frame.words.tolist()) == sent


@pytest.mark.parametrize("damage", ["header", "footer", "short", "empty", "odd"])
def test_a_damaged_frame_is_refused(damage):
    data = encode_frame(1, np.zeros(NUM_WORDS, np.uint32))
    broken = {
        "header": b"\0" + data[1:],
        "footer": data[:-1] + b"\0",
        "short": data[:-4],
        "empty": b"",
        "odd": data + b"\0",
    }[damage]
    with pytest.raises(FrameCorrupt, match="expected"):
        protocol.decode_frame(broken)


@pytest.mark.parametrize(
    ("args", "line"),
    [
        (("Y",), b"!Y,0,0,0\n"),
        (("G", 655_360), b"!G,655360,0,0\n"),
        (("C", 7, 2048), b"!C,7,2048,0\n"),
        (("J", 1, 2), b"!J,1,2,0,0\n"),
        (("A", 1), b"!A,1,0,0\n"),
    ],
)
def test_a_command_is_one_line(args, line):
    assert protocol.encode_command(*args) == line


@pytest.mark.parametrize(
    "args",
    [("Q",), ("Y", 1), ("C", 1), ("C", 65_535, 0), ("C", 0, 4096), ("D", 159_999), ("J", 1, 3)],
)
def test_a_command_out_of_range_is_refused(args):
    with pytest.raises(SettingsError, match="expected"):
        protocol.encode_command(*args)


def test_a_frame_size_is_in_bytes_and_a_multiple_of_its_step():
    assert protocol.encode_frame_size(163_840) == b"!G,655360,0,0\n"
    with pytest.raises(SettingsError, match="multiple of 32768"):
        protocol.encode_frame_size(163_841)


def test_the_two_trigger_forms_are_opposite():
    assert protocol.encode_trigger(active=True) == b"!A,1,0,0\n"
    assert protocol.encode_trigger(active=False) == b"!A,0,0,0\n"
    assert protocol.encode_trigger(active=True, form="windows") == b"!A,0,0,0"


@pytest.mark.parametrize("source", ["live", "sim", "replay"])
def test_a_version_word_says_version_and_source(source):
    word = protocol.encode_version("2.3.4", source)
    assert word & 0xFFFFFF == 131_844
    assert protocol.parse_firmware(word) == "2.3.4"
    assert protocol.parse_source(word) == source


def test_a_version_word_with_another_mark_is_no_ertis():
    with pytest.raises(WrongDevice, match="0x4f020304"):
        protocol.parse_source(ord("O") << 24 | 0x020304)


def test_the_chirp_hash_is_blind_to_order():
    codes = np.array([2048, 4095, 1, 7], np.uint16)
    assert protocol.chirp_hash(codes) == 2048 ^ 4095 ^ 1 ^ 7
    assert protocol.chirp_hash(codes[::-1]) == protocol.chirp_hash(codes)

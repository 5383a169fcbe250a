from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver import protocol
from ertis_driver.frame_parser import FrameParser
from ertis_driver.ping_counter import PingCounter
from ertis_driver.protocol import FOOTER, HEADER, HEADER_BYTES, encode_frame

NUM_WORDS = 6
words_lists = st.lists(
    # Header and footer words inside the payload are what a careless parser trips over.
    st.sampled_from([HEADER, FOOTER, 0, 0xFFFFFFFF]) | st.integers(0, 2**32 - 1),
    min_size=NUM_WORDS,
    max_size=NUM_WORDS,
)


def imitates(frame):
    """Its payload holds the beginning of a later frame: that is refused, see below."""
    index, words = frame
    pairs = pairwise(words)
    return any(a == HEADER and 0 < (b - index) % 2**32 <= 1000 for a, b in pairs)


frames = st.tuples(st.integers(0, 2**32 - 1), words_lists).filter(lambda f: not imitates(f))
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


@pytest.mark.parametrize("num_words", [0, -1])
def test_frames_without_words_are_refused(num_words):
    with pytest.raises(ValueError, match="expected 1 at least"):
        FrameParser(num_words)


def test_clear_forgets_half_a_frame():
    parser = FrameParser(NUM_WORDS)
    data = encode_frame(3, np.zeros(NUM_WORDS, np.uint32))
    parser.feed(data[:20])
    assert parser.clear() == 20
    assert [frame.index for frame in parser.feed(data)] == [3]


def counted(last):
    """A counter that has just met this index, in a world where no time passes."""
    counter = PingCounter(1.0, now_s=lambda: 0.0)
    counter.take(last)
    return counter


def test_a_frame_whose_end_is_borrowed_from_the_next_is_refused():
    """Bytes were lost in the first, and the second holds a footer just where it fits."""
    first = encode_frame(7, np.arange(NUM_WORDS, dtype=np.uint32))
    second = encode_frame(8, np.array([1, FOOTER, 3, 4, 5, 6], np.uint32))
    third = encode_frame(9, np.zeros(NUM_WORDS, np.uint32))
    lost = 16  # from the second's begin to behind that footer
    parser = FrameParser(NUM_WORDS)
    found = parser.feed(first[: len(first) - lost] + second + third)
    assert [frame.index for frame in found] == [8, 9]
    assert found[0].words.tolist() == [1, FOOTER, 3, 4, 5, 6]
    assert parser.frames_corrupt == 1
    assert parser.bytes_lost == len(first) - lost


def test_a_frame_pictured_inside_the_payload_of_a_damaged_one_is_not_delivered():
    """Its header is wrong, and what follows in it has header and footer one frame size apart."""
    counter = counted(6)
    payload = np.array([HEADER, 0x77777777, 1, 2, 3, 4], np.uint32)
    damaged = b"\0" + encode_frame(7, payload)[1:]
    following = encode_frame(8, np.array([5, FOOTER, 6, 7, 8, 9], np.uint32))[4:]
    third = encode_frame(9, np.zeros(NUM_WORDS, np.uint32))
    picture = damaged + following[: -4 * NUM_WORDS - 4] + following + third
    parser = FrameParser(NUM_WORDS, counter.plausible)
    found = parser.feed(picture)
    assert 0x77777777 not in [frame.index for frame in found]
    assert found[-1].index == 9


def test_after_lost_bytes_a_counter_that_began_anew_costs_one_frame():
    counter = counted(5000)
    parser = FrameParser(NUM_WORDS, counter.plausible)
    stream = b"junk" + b"".join(encode_frame(i, np.zeros(NUM_WORDS, np.uint32)) for i in range(3))
    assert [frame.index for frame in parser.feed(stream)] == [1, 2]
    assert parser.frames_corrupt == 1


def test_in_step_any_index_is_delivered():
    counter = counted(5000)
    parser = FrameParser(NUM_WORDS, counter.plausible)
    (frame,) = parser.feed(encode_frame(0, np.zeros(NUM_WORDS, np.uint32)))
    assert frame.index == 0


@given(plain, st.integers(0, 60))
def test_flush_finds_the_frame_behind_a_header_that_waits_for_more(sent, distance):
    parser = FrameParser(NUM_WORDS)
    assert parser.feed(HEADER_BYTES + bytes(distance)) in ([], [])
    found = simple(parser.feed(as_bytes(sent)))
    assert found + simple(parser.flush()) == [sent]
    assert parser.pending_bytes == 0
    assert parser.frames_corrupt == 1
    assert parser.bytes_lost == len(HEADER_BYTES) + distance


def test_flush_counts_half_a_frame_as_corrupt():
    parser = FrameParser(NUM_WORDS)
    parser.feed(encode_frame(1, np.zeros(NUM_WORDS, np.uint32))[:20])
    assert parser.flush() == []
    assert (parser.bytes_lost, parser.frames_corrupt) == (20, 1)


quiet_words = st.integers(0, 2**32 - 1).filter(
    lambda word: not {0x12, 0x72} & set(word.to_bytes(4, "little"))
)
damages = st.sampled_from(["lose", "double", "insert", "header", "footer"])


@given(
    st.lists(st.lists(quiet_words, min_size=6, max_size=6), min_size=5, max_size=5),
    st.integers(0, 2),
    damages,
    st.integers(0, 35),
    st.integers(1, 12),
    st.lists(st.integers(0, 200), max_size=5),
)
def test_one_damage_costs_its_frame_and_at_most_one_more(payloads, which, damage, at, size, cuts):
    """Real streams: indices that count, payloads that imitate nothing."""
    sent = [(1000 + 0x01010000 + i, words) for i, words in enumerate(payloads)]
    parts = [as_bytes(frame) for frame in sent]
    whole = parts[which]
    parts[which] = {
        "lose": whole[:at] + whole[at + size :],
        "double": whole[: at + size] + whole[at:],
        "insert": whole[:at] + bytes([0xAA]) * size + whole[at:],
        "header": bytes([whole[0] ^ 0xFF]) + whole[1:],
        "footer": whole[:-1] + bytes([whole[-1] ^ 0xFF]),
    }[damage]
    parser = FrameParser(NUM_WORDS, counted(sent[0][0] - 1).plausible)
    stream = b"".join(parts)
    found = simple(feed_all(parser, cut(stream, cuts)))
    found += simple(parser.flush())
    assert [frame for frame in found if frame not in sent] == []
    assert len(found) >= len(sent) - 2
    assert set(range(5)) - {sent.index(frame) for frame in found} <= {which, which + 1}
    in_frames = len(found) * protocol.frame_bytes(NUM_WORDS)
    assert in_frames + parser.bytes_lost == len(stream)

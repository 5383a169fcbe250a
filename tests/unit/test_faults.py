import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from ertis_driver.errors import SettingsError
from ertis_driver.fault_plan import (
    DRAWN_KINDS,
    DrawnFaults,
    FaultInjector,
    NamedFaults,
    PlannedFault,
    draw_fault,
    parse_fault,
)
from ertis_driver.faults import (
    FAULTS,
    Babble,
    Double,
    Drop,
    Flip,
    Insert,
    Jump,
    Late,
    Magic,
    Reset,
    Silent,
    Stall,
    Truncate,
    Vanish,
)
from ertis_driver.outbox import HangUp, Outbox, Pause, Rubbish

FOREVER = math.inf


class Counter:
    """A device that counts."""

    def __init__(self):
        self.ping_index = 7
        self.resets = 0

    def reset(self):
        self.resets += 1

    def ping(self, *, active):
        return b"another frame"


class Wire:
    """A port with room for so many bytes at a time."""

    def __init__(self, room=10**9):
        self.room = room
        self.data = b""

    def write(self, data):
        if self.room == 0:
            raise BlockingIOError
        taken = bytes(data[: self.room])
        self.room -= len(taken)
        self.data += taken
        return len(taken)


def only(fault, unit="frame", number=0):
    return FaultInjector(NamedFaults([PlannedFault(fault, unit, number)]), Counter())


def sent(fault, message):
    """What reaches the wire of a message with this fault, however long that takes."""
    outbox, wire = Outbox(), Wire()
    outbox.put(only(fault).inject(message), is_frame=True)
    outbox.advance(wire.write, 0.0)
    outbox.advance(wire.write, 1e9)
    outbox.advance(wire.write, 2e9)
    return wire.data


messages = st.binary(min_size=5, max_size=60)
places = st.integers(-70, 70)
counts = st.integers(1, 70)


def cut(message, place):
    start = max(len(message) + place, 0) if place < 0 else place
    return message[:start], message[start:]


@given(st.lists(st.binary(min_size=4, max_size=40), max_size=6))
def test_without_a_fault_every_byte_goes_through_as_it_is(sent_messages):
    for plan in (None, NamedFaults([]), DrawnFaults(1, 0.0)):
        injector = FaultInjector(plan, Counter())
        for message in sent_messages:
            assert injector.inject(message) == [message]
        assert not injector.injected


@given(messages, places, counts)
def test_what_a_fault_does_not_touch_comes_out(message, place, count):
    before, after = cut(message, place)
    assert sent(Drop(place, count), message) == before + after[count:]
    assert sent(Double(place, count), message) == before + after[:count] + after
    inserted = sent(Insert(place, count, seed=5), message)
    assert (inserted[: len(before)], inserted[len(before) + count :]) == (before, after)
    assert len(inserted) == len(message) + count
    assert sent(Stall(place, 3.0), message) == message
    assert sent(Truncate(place), message) == before + b"another frame"
    for fault in (Silent(place), Silent(place, 1), Vanish(place), Reset(place)):
        assert sent(fault, message) == before
    babble = sent(Babble(place, 0.5), message)
    assert babble.startswith(before)
    assert len(babble) > len(message)


@given(messages, places, st.integers(1, 255))
@example(b"12345", 5, 1)
def test_a_flip_changes_its_bits_alone_and_twice_is_none(message, place, mask):
    flipped = sent(Flip(place, mask), message)
    changes = [a ^ b for a, b in zip(message, flipped, strict=True) if a != b]
    assert changes == ([mask] if cut(message, place)[1] else [])
    assert sent(Flip(place, mask), flipped) == message


@given(messages.filter(lambda message: len(message) >= 12))
def test_a_wrong_magic_replaces_one_end(message):
    assert sent(Magic(word=0x04030201), message) == b"\1\2\3\4" + message[4:]
    assert sent(Magic(footer=1, word=0x04030201), message) == message[:-4] + b"\1\2\3\4"


@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(FAULTS)), st.integers(4, 200_000))
def test_a_drawn_fault_is_what_its_text_says(seed, kind, size):
    fault = draw_fault(np.random.default_rng(seed), kind, size)
    assert fault == draw_fault(np.random.default_rng(seed), kind, size), "same seed, same fault"
    planned = PlannedFault(fault, "frame", seed % 100)
    assert parse_fault(str(planned)) == planned


def test_what_is_drawn_for_a_frame_depends_on_seed_and_number_alone():
    first, again, other = DrawnFaults(42, 0.3), DrawnFaults(42, 0.3), DrawnFaults(43, 0.3)
    drawn = [first.pick("frame", number, 1000) for number in range(300)]
    backwards = [again.pick("frame", number, 1000) for number in reversed(range(300))]
    assert drawn == backwards[::-1]
    assert drawn != [other.pick("frame", number, 1000) for number in range(300)]
    assert 60 < sum(fault is not None for fault in drawn) < 120
    assert {fault.kind for fault in drawn if fault} == set(DRAWN_KINDS)
    assert first.pick("reply", 1, 4) is None


def test_only_the_named_message_is_hit_and_frames_and_replies_are_counted_apart():
    injector = FaultInjector(
        NamedFaults([parse_fault("drop@frame=1,byte=2,count=1"), parse_fault("flip@reply=1")]),
        Counter(),
    )
    outputs = [b"".join(injector.inject(m)) for m in (b"reply", b"1234", b"frame", b"1234")]
    assert outputs == [b"reply", b"1234", b"frme", b"\x30234"]
    assert [str(planned) for planned in injector.injected] == [
        "drop@frame=1,byte=2,count=1",
        "flip@reply=1,byte=0,mask=1",
    ]


@pytest.mark.parametrize(
    ("past_replies", "outputs"),
    [(0, [b"", b"frame1234", b"later"]), (1, [b"", b"1234", b"framelater"])],
)
def test_a_late_frame_comes_in_front_of_a_later_message(past_replies, outputs):
    injector = only(Late(past_replies=past_replies))
    assert [b"".join(injector.inject(m)) for m in (b"frame", b"1234", b"later")] == outputs


def test_a_jump_and_a_reset_happen_in_the_device():
    device = Counter()
    for fault, index, resets in [(Jump(by=5), 12, 0), (Jump(by=-13), 2**32 - 1, 0)]:
        fault.steps(b"frame", device)
        assert (device.ping_index, device.resets) == (index, resets)
    Reset().steps(b"frame", device)
    assert device.resets == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("dorp@frame=1", "expected drop?"),
        ("drop@frame=1,cuont=1", "expected count?"),
        ("drop", "does not say to what"),
        ("drop@byte=1", "one of frame=N and reply=N"),
        ("drop@frame=1,reply=2", "one of frame=N and reply=N"),
        ("drop@frame=-1", "one of frame=N and reply=N"),
        ("drop@frame=x", "expected a number"),
        ("drop@frame", "expected a number"),
        ("drop@frame=1,count=0", "count 0, expected 1 to"),
        ("flip@frame=1,mask=256", "mask 256, expected 1 to 255"),
        ("stall@frame=1,seconds=nan", "seconds nan"),
        ("@frame=1", "unknown, expected one of drop"),
    ],
)
def test_a_fault_that_cannot_be_says_what_was_expected(text, says):
    with pytest.raises(SettingsError) as caught:
        parse_fault(text)
    assert says in str(caught.value)


def test_a_rate_that_is_no_share_is_refused():
    for rate in (-0.1, 1.1, math.nan):
        with pytest.raises(SettingsError, match="0 to 1"):
            DrawnFaults(1, rate)
    with pytest.raises(SettingsError, match="expected drop"):
        DrawnFaults(1, 0.5, ["dropp"])


def test_a_pause_holds_back_what_comes_behind_it():
    outbox, wire = Outbox(), Wire()
    outbox.put([b"one", Pause(2.0), b"two"], is_frame=True)
    outbox.put([b"three"], is_frame=False)
    outbox.advance(wire.write, 10.0)
    assert (wire.data, outbox.due_in_s(11.5), outbox.wants_to_write) == (b"one", 0.5, False)
    outbox.advance(wire.write, 11.9)
    assert wire.data == b"one"
    outbox.advance(wire.write, 12.0)
    assert wire.data == b"onetwothree"
    assert outbox.due_in_s(12.0) == FOREVER


@given(st.binary(min_size=1, max_size=50), st.lists(st.integers(0, 7), max_size=60))
def test_a_port_that_takes_little_at_a_time_gets_it_all_in_order(data, rooms):
    outbox, wire = Outbox(), Wire(room=0)
    outbox.put([data], is_frame=True)
    for room in rooms:
        wire.room = room
        outbox.advance(wire.write, 0.0)
        assert wire.data == data[: len(wire.data)]
    wire.room = 1000
    outbox.advance(wire.write, 0.0)
    assert wire.data == data


def test_silence_ends_with_the_next_command_unless_it_is_for_ever():
    for ever in (0, 1):
        outbox, wire = Outbox(), Wire()
        outbox.put(only(Silent(3, ever)).inject(b"frame"), is_frame=True)
        outbox.put([b"unasked"], is_frame=True)
        outbox.advance(wire.write, 0.0)
        assert wire.data == b"fra"
        outbox.command_came()
        outbox.put([b"reply"], is_frame=False)
        outbox.advance(wire.write, 0.0)
        assert wire.data == (b"fra" if ever else b"frareply")


def test_rubbish_ends_when_its_time_is_up():
    outbox, wire = Outbox(), Wire()
    outbox.put([Rubbish(b"xyz", 1.0), b"end"], is_frame=True)
    for now_s in (0.0, 0.5, 0.99):
        assert outbox.advance(wire.write, now_s) is None
    outbox.advance(wire.write, 1.0)
    assert wire.data == b"xyz" * 3 + b"end"


def test_after_a_hang_up_nothing_is_left():
    outbox, wire = Outbox(), Wire()
    outbox.put(only(Vanish(2, 0.5)).inject(b"frame"), is_frame=True)
    outbox.put([b"more"], is_frame=False)
    assert outbox.advance(wire.write, 0.0) == HangUp(0.5)
    assert outbox.advance(wire.write, 9.0) is None
    assert wire.data == b"fr"

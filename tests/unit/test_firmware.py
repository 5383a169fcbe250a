import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ertis_driver import protocol
from ertis_driver.errors import SettingsError
from ertis_driver.firmware import FirmwareState

SMALL = b"!G,131072,0,0\n"


class Silence:
    """Frames of zeros; remembers what was asked."""

    def __init__(self):
        self.requests = []

    def next_frame(self, request):
        self.requests.append(request)
        return np.zeros(request.num_words, np.uint32)


@pytest.fixture
def source():
    return Silence()


@pytest.fixture
def state(source):
    return FirmwareState(source)


def replies(state, data):
    """Reply words; a frame counts as its index."""
    return [
        protocol.decode_frame(reply).index if len(reply) > 4 else protocol.decode_reply(reply)
        for reply in state.feed(data)
    ]


@pytest.mark.parametrize("line", [b"!J,1,2,0,0\n", b"!J,1,2,0\n", b"!J,1,2,0\r\n"])
def test_both_forms_of_j_enable_a_pin(state, line):
    state.feed(SMALL)
    assert state.trigger(2) is None, "off at boot"
    assert replies(state, line) == [1]
    assert protocol.decode_frame(state.trigger(2)).index == 0
    assert state.trigger(1) is None, "the other pin"
    assert replies(state, b"!J,0,0,0\n") == [0]
    assert state.trigger(2) is None


def test_h_says_whether_a_triggered_ping_emits(state, source):
    state.feed(SMALL + b"!J,1,1,0,0\n")
    for line in (b"", b"!H,1,0,0\n", b"!H,0,0,0\n"):
        state.feed(line)
        state.trigger(1)
    assert [request.active for request in source.requests] == [False, True, False]
    assert [request.index for request in source.requests] == [0, 1, 2]


def test_clock_emissions_amplifier_and_counter_take_effect(state, source):
    state.feed(SMALL)
    assert replies(state, b"!F,1,0,0\n!I,3,0,0\n!K,1,0,0\n!B,4294967295,0,0\n") == [
        1,
        3,
        1,
        2**32 - 1,
    ]
    assert replies(state, b"!A,1,0,0\n!A,1,0,0\n") == [2**32 - 1, 0]
    request = source.requests[0]
    assert (request.pdm_rate_hz, request.emissions, request.amplified) == (1_125_000, 3, True)


@pytest.mark.parametrize(("letter", "line"), [("J", b"!J,1,1,0,0\n"), ("K", b"!K,1,0,0\n")])
def test_firmware_without_j_or_k_says_so(source, letter, line):
    state = FirmwareState(source, unsupported=letter)
    state.feed(SMALL)
    assert replies(state, line) == [0]
    assert state.trigger(1) is None
    state.feed(b"!A,1,0,0\n")
    assert not source.requests[0].amplified


def test_nothing_else_can_be_unsupported(source):
    with pytest.raises(SettingsError, match="expected some of J, K"):
        FirmwareState(source, unsupported="G")


@pytest.mark.parametrize("form", ["linux", "windows"])
def test_the_polarity_of_a_can_be_chosen(source, form):
    state = FirmwareState(source, trigger_form=form)
    state.feed(SMALL)
    for active in (True, False):
        state.feed(protocol.encode_trigger(active=active, form=form))
    assert [request.active for request in source.requests] == [True, False]


def test_a_without_newline_pings_at_once_and_takes_the_newline_that_follows(state, source):
    state.feed(SMALL)
    assert replies(state, b"!A,0,0,0") == [0]
    assert replies(state, b"\n!A,0,0,0!Y,0,0,0\n") == [1, 131_844 | ord("S") << 24]
    assert replies(state, b"noise!A,1,0,0\r") == [2]
    assert state.feed(b"\n") == []
    assert state.garbage_lines == 0
    assert state.feed(b"\n") == []
    assert state.garbage_lines == 1, "only one newline belongs to a trigger"


commands = st.sampled_from(
    [b"!A,1,0,0\n", b"!A,0,0,0", b"!B,7,0,0\n", b"!J,1,1,0\n", b"!J,1,2,0,0\n", b"!C,0,5,0\n"]
)


@given(st.lists(commands, max_size=5), st.lists(st.integers(0, 60), max_size=6))
def test_commands_cut_anywhere_do_the_same(sent, cuts):
    stream = b"".join(sent)
    whole, pieces = FirmwareState(Silence()), FirmwareState(Silence())
    whole.feed(SMALL)
    pieces.feed(SMALL)
    points = sorted(min(cut, len(stream)) for cut in cuts)
    parts = [stream[a:b] for a, b in zip([0, *points], [*points, len(stream)], strict=True)]
    found = [reply for part in parts for reply in replies(pieces, part)]
    assert found == replies(whole, stream)
    assert pieces.garbage_lines == whole.garbage_lines == 0
    assert len(found) == len(sent)


@pytest.mark.parametrize(
    "line", [b"!A,2,0,0\n", b"!A,1,0\n", b"!Q,1,0,0\n", b"!G,1,0,0,0,0\n", b"!g,1,0,0\n"]
)
def test_what_is_no_command_gets_no_answer(state, line):
    assert state.feed(line) == []
    assert state.garbage_lines == 1


@pytest.mark.parametrize(
    ("line", "held"),
    [(b"!J,1,3,0\n", 0), (b"!H,2,0,0\n", 0), (b"!I,0,0,0\n", 1), (b"!D,1,0,0\n", 450_000)],
)
def test_what_is_out_of_range_changes_nothing(state, line, held):
    assert replies(state, line) == [held]

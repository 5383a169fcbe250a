"""What an emulated sonar really sent, and whether what a client got is that."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass

import numpy as np

from ertis_driver.faults import Fault, Flip
from ertis_driver.protocol import FOOTER, HEADER

NUM_WORDS = 32_768
SLACK_NS = 1_000_000  # between two readings of two clocks
LISTENING_NS = 7_281_778 + SLACK_NS
DELAY_NS = 20_000_000_000  # what threads that share two cores may wait for each other
HASH_STEP = 2_654_435_761  # odd: each serial number has a key of its own, modulo 2**32


def _base_words():
    words = np.random.default_rng(20_260_704).integers(0, 2**32, 5 * NUM_WORDS, dtype=np.uint32)
    # Words that no key moves, so that each frame holds headers and footers where none belong.
    words[1000:2000:97] = HEADER
    words[20_000:21_000:89] = FOOTER
    return words


BASE = _base_words()
KEYED = (BASE != HEADER) & (BASE != FOOTER)


@dataclass(slots=True)
class Sent:
    """One frame that the firmware made.

    serial counts the frames of this ledger; index is the device's own count.
    """

    serial: int
    index: int
    made_ns: int
    dac_codes: np.ndarray
    fault: Fault | None = None
    delivered: bool = False

    @property
    def moved(self) -> bool:
        """It left with another index than the firmware gave it."""
        return isinstance(self.fault, Flip) and 4 <= self.fault.byte < 8

    def words(self, num_words: int = NUM_WORDS) -> np.ndarray:
        """As the firmware made them: random, and another set for each serial number."""
        key = np.uint32((self.serial + 1) * HASH_STEP % 2**32)
        return np.where(KEYED[:num_words], BASE[:num_words] ^ key, BASE[:num_words])

    def on_the_wire(self) -> tuple[int, np.ndarray]:
        """Index and words as they left, with the one kind of fault that no framing can show."""
        words = self.words()
        if not isinstance(self.fault, Flip):
            return self.index, words
        data = bytearray(b"\0\0\0\0" + self.index.to_bytes(4, "little") + words.tobytes())
        if self.fault.byte < len(data):
            data[self.fault.byte] ^= self.fault.mask
        return int.from_bytes(data[4:8], "little"), np.frombuffer(data, "<u4", offset=8)


class Ledger:
    """Frame source and fault plan in one: each frame is noted, one armed fault is applied."""

    def __init__(self) -> None:
        self.sent: list[Sent] = []
        self.fired_s: float | None = None
        self.fired_serial = 0
        self._armed: tuple[str, int, Fault] | None = None
        self._lock = threading.Lock()

    def next_frame(self, request):
        with self._lock:
            sent = Sent(len(self.sent), request.index, time.time_ns(), request.dac_codes)
            self.sent.append(sent)
        return sent.words(request.num_words)

    def arm(self, fault: Fault, unit: str, countdown: int = 0) -> None:
        """Let it happen to the next frame or reply, or to one ``countdown`` further on."""
        with self._lock:
            self.fired_s = None
            self._armed = unit, countdown, fault

    def disarm(self) -> bool:
        """Take back what has not happened yet; return whether it had."""
        with self._lock:
            self._armed = None
            return self.fired_s is not None

    def pick(self, unit, number, size):
        with self._lock:
            if self._armed is None or self._armed[0] != unit:
                return None
            unit, countdown, fault = self._armed
            if countdown:
                self._armed = unit, countdown - 1, fault
                return None
            self._armed = None
            self.fired_s = time.monotonic()
            self.fired_serial = len(self.sent) - 1
            if unit == "frame":
                self.sent[-1].fault = fault
            return fault

    def find(self, words) -> Sent | None:
        """Whose words these claim to be; the first and the last are asked."""
        with self._lock:
            for at in (0, -1):
                key = int(words[at] ^ BASE[:NUM_WORDS][at])
                serial = key * pow(HASH_STEP, -1, 2**32) % 2**32 - 1
                if 0 <= serial < len(self.sent):
                    return self.sent[serial]
        return None

    def judge(self, frame, chirp_codes) -> Sent:
        """Return what was delivered.

        Raises
        ------
        AssertionError
            If it is not exactly one frame that was sent, with its own index, for the first time.
        """
        sent = self.find(frame.words)
        assert sent is not None, f"frame {frame.ping_index} was never sent"
        index, words = sent.on_the_wire()
        assert frame.words.shape == words.shape, "another length than was sent"
        assert np.array_equal(frame.words, words), f"frame {sent.index} was changed or mixed"
        assert frame.ping_index == index, f"frame {index} came as {frame.ping_index}"
        assert not sent.delivered, f"frame {index} came twice"
        assert np.array_equal(sent.dac_codes, chirp_codes), "emitted with another chirp"
        sent.delivered = True
        return sent

    @staticmethod
    def judge_time(frame, sent, asked_ns, got_ns) -> None:
        """The time of a ping that was asked for lies in the asking, and before its frame.

        Raises
        ------
        AssertionError
        """
        low = frame.ping_time_ns - frame.time_uncertainty_ns
        assert asked_ns - SLACK_NS <= low, "said to be older than the ping"
        assert low <= sent.made_ns, f"frame {sent.index} was made before the time it is given"
        assert frame.ping_time_ns <= got_ns, "said to be younger than its arrival"

    @staticmethod
    def judge_estimate(frame, sent, got_ns) -> None:
        """The time of a ping that came unasked.

        The emulator does not take the time to listen, and a busy machine delays what it sends.

        Raises
        ------
        AssertionError
        """
        low = frame.ping_time_ns - frame.time_uncertainty_ns
        high = frame.ping_time_ns + frame.time_uncertainty_ns
        assert low - DELAY_NS <= sent.made_ns <= high + LISTENING_NS, "another ping's time"
        assert frame.ping_time_ns <= got_ns, "said to be younger than its arrival"

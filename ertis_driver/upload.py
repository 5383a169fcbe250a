"""The chirp into the device: every sample sent, and what it holds compared."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ertis_driver.chirp import DAC_IDLE_CODE
from ertis_driver.errors import UploadFailed
from ertis_driver.exchanges import Exchanges
from ertis_driver.protocol import REPLY_BYTES, chirp_hash, encode_command

log = logging.getLogger(__name__)

Codes = npt.NDArray[np.uint16]
Progress = Callable[[int, int], None]  # samples sent, samples in all

UPLOAD_BATCH = 16  # commands of at most 16 B: half a high-speed USB packet in flight


class ChirpMemory:
    """The device's chirp memory, and what this session knows to be in it.

    The hash that the device offers is blind to order: a reversed sweep has the same one. So it
    never says that an upload is needless; only having sent exactly these codes before does, and
    then the hash that they left behind must still stand.

    Parameters
    ----------
    exchanges
        The way to the device.
    progress
        Called after each batch.
    """

    def __init__(self, exchanges: Exchanges, progress: Progress | None = None) -> None:
        self._exchanges = exchanges
        self._progress = progress
        self._sent: bytes | None = None
        self._hash_left = 0

    def forget(self) -> None:
        """Trust nothing: the device may have restarted."""
        self._sent = None

    def put(self, codes: Codes) -> None:
        """Make the device hold these codes; ``E`` must have been set to their number.

        Parameters
        ----------
        codes : uint16, shape (n,)

        Raises
        ------
        UploadFailed
            If it holds others afterwards.
        DeviceTimeout, DeviceLost
        """
        content = codes.tobytes()
        met = self._hash()
        if content == self._sent and met == self._hash_left and not _looks_idle(met):
            log.debug("chirp sent before in this session and still there")
            return
        self._sent = None
        self._hash_left = self._send_checked(codes)
        self._sent = content

    def _send_checked(self, codes: Codes) -> int:
        expected = chirp_hash(codes)
        self._send(codes)
        met = self._hash()
        if met == expected:
            return met
        # Nobody knows whether L covers the samples in use or the whole memory. With zeros in the
        # former, it yields what the rest of the memory adds.
        log.info("chirp hash 0x%x, expected 0x%x: checking", met, expected)
        self._send(np.zeros_like(codes))
        rest = self._hash()
        self._send(codes)
        met = self._hash()
        if met ^ rest != expected:
            raise UploadFailed(
                f"the device holds another chirp than was sent (hash 0x{met ^ rest:x}, "
                f"expected 0x{expected:x}): configure it again, replug it if that persists"
            )
        return met

    def _send(self, codes: Codes) -> None:
        for start in range(0, len(codes), UPLOAD_BATCH):
            batch = codes[start : start + UPLOAD_BATCH].tolist()
            lines = [encode_command("C", start + i, code) for i, code in enumerate(batch)]
            self._exchanges.exchange(b"".join(lines), REPLY_BYTES * len(batch))
            if self._progress is not None:
                self._progress(start + len(batch), len(codes))

    def _hash(self) -> int:
        return self._exchanges.command(encode_command("L"))


def _looks_idle(met: int) -> bool:
    """Whether a memory that was just switched on might have this hash too."""
    return met in (0, DAC_IDLE_CODE)

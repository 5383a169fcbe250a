"""PDM words made smaller, without loss: each word XOR the one before it, bits sorted, zstd.

PDM looks like noise to any compressor. One microphone's bits, taken for themselves and turned into
"changed" or "did not", are less even: by a third, on quiet pings.
"""

from __future__ import annotations

import struct

import numpy as np
import numpy.typing as npt
import zstandard

from ertis_driver.errors import FrameCorrupt
from ertis_driver.frame import NUM_MICS
from ertis_driver.protocol import Bytes, RawFrame, decode_frame, encode_frame

PLAIN, PLANES = "ertis-frame", "ertis-frame-planes-zstd"
LEVEL = 1  # what is higher takes longer than a ping, for a tenth less
_HEAD = struct.Struct("<II")  # ping index, number of words


def encode_planes(words: npt.NDArray[np.uint32], level: int = LEVEL) -> bytes:
    """Compress words, uint32 of shape (n,) with n a multiple of 32.

    Raises
    ------
    ValueError
        If it is not.
    """
    if words.size % NUM_MICS:
        raise ValueError(f"{words.size} words, expected a multiple of {NUM_MICS}")
    changed = words.astype("<u4")
    changed[1:] ^= words[:-1]
    blocks = changed.reshape(-1, NUM_MICS)
    _transpose_bits(blocks)
    # Row m: the bits of microphone m, 32 after 32.
    return zstandard.ZstdCompressor(level=level).compress(blocks.T.tobytes())


def decode_planes(data: Bytes, num_words: int) -> npt.NDArray[np.uint32]:
    """Return the words that ``encode_planes`` took; uint32, shape (num_words,).

    Never takes more memory than so many words need, whatever the data says.

    Raises
    ------
    ValueError
        If the data is anything else.
    """
    size = 4 * num_words
    try:
        if num_words % NUM_MICS or zstandard.frame_content_size(data) != size:
            raise ValueError(f"compressed frame that is not one of {num_words} words")
        plain = zstandard.ZstdDecompressor(max_window_size=1 << 26).decompress(data, size)
    except zstandard.ZstdError as error:
        raise ValueError(f"compressed frame: {error}") from error
    planes = np.frombuffer(plain, "<u4").reshape(NUM_MICS, -1)
    blocks = np.array(planes.T, order="C")
    _transpose_bits(blocks)
    words = blocks.reshape(-1)
    np.bitwise_xor.accumulate(words, out=words)
    return words.astype(np.uint32, copy=False)


def encode_recorded(index: int, words: npt.NDArray[np.uint32], encoding: str) -> bytes:
    """Make a frame as it stands in a recording of this encoding."""
    if encoding == PLAIN:
        return encode_frame(index, words)
    return _HEAD.pack(index, words.size) + encode_planes(words)


def decode_recorded(data: Bytes, encoding: str, num_words: int) -> RawFrame:
    """Read a frame as it stands in a recording of frames of so many words.

    Raises
    ------
    FrameCorrupt, ValueError
        If it is none.
    """
    if encoding != PLANES:
        return decode_frame(data)
    if len(data) < _HEAD.size:
        raise FrameCorrupt(f"compressed frame of {len(data)} bytes")
    index, count = _HEAD.unpack_from(data)
    if count != num_words:
        raise ValueError(f"compressed frame of {count} words, expected {num_words}")
    return RawFrame(index, decode_planes(memoryview(data)[_HEAD.size :], num_words))


def _transpose_bits(blocks: npt.NDArray[np.uint32]) -> None:
    """Turn each row of 32 words, a square of bits, about its diagonal; in place.

    By halves of halves, as Warren, Hacker's Delight, section 7-3, has it.
    """
    step, mask = 16, 0x0000FFFF
    while step:
        pairs = blocks.reshape(-1, NUM_MICS // (2 * step), 2, step)
        low, high = pairs[:, :, 0], pairs[:, :, 1]
        swapped = low >> np.uint32(step)
        swapped ^= high
        swapped &= np.uint32(mask)
        high ^= swapped
        swapped <<= np.uint32(step)
        low ^= swapped
        step //= 2
        mask ^= (mask << step) & 0xFFFFFFFF

"""Pictures as PNG, by numpy and zlib alone: a recording makes several a second."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import numpy.typing as npt

_MAGIC = b"\x89PNG\r\n\x1a\n"
_INDEXED = 3
_FAST = 1
# Dark violet over red to pale yellow, even in lightness: red, green, blue at even steps.
_STOPS = (
    *((0, 0, 4), (28, 16, 68), (79, 18, 123), (129, 37, 129), (181, 54, 122)),
    *((229, 80, 100), (251, 135, 97), (254, 194, 135), (252, 253, 191)),
)
# 3 by 5 pixels a letter, rows from the top; only those that sources are named with.
_LETTERS = {
    "A": "75755",
    "D": "65556",
    "E": "74647",
    "I": "72227",
    "L": "44447",
    "M": "57755",
    "P": "75744",
    "R": "75765",
    "S": "74717",
    "T": "72222",
    "U": "55557",
    "Y": "55222",
}
_SCALE = 3


def palette() -> npt.NDArray[np.uint8]:
    """256 colours, shape (256, 3)."""
    stops = np.array(_STOPS, np.float64)
    at = np.linspace(0, len(stops) - 1, 256)
    columns = [np.interp(at, np.arange(len(stops)), stops[:, channel]) for channel in range(3)]
    return np.rint(np.column_stack(columns)).astype(np.uint8)


def encode_png(pixels: npt.NDArray[np.uint8], colours: npt.NDArray[np.uint8]) -> bytes:
    """Make a PNG file.

    Parameters
    ----------
    pixels : uint8, shape (height, width)
        Numbers of colours; the first row is the top.
    colours : uint8, shape (256, 3)
        Red, green, blue.
    """
    height, width = pixels.shape
    rows = np.zeros((height, width + 1), np.uint8)  # a filter type before each: none
    rows[:, 1:] = pixels
    head = struct.pack(">IIBBBBB", width, height, 8, _INDEXED, 0, 0, 0)
    body = zlib.compress(rows.tobytes(), _FAST)
    chunks = ((b"IHDR", head), (b"PLTE", colours.tobytes()), (b"IDAT", body), (b"IEND", b""))
    return _MAGIC + b"".join(_chunk(name, data) for name, data in chunks)


def stamp(pixels: npt.NDArray[np.uint8], text: str, colour: int = 255) -> None:
    """Write a word into the upper left corner, in place; letters that it has none of are blanks."""
    at = _SCALE
    for letter in text:
        for row, digit in enumerate(_LETTERS.get(letter, "00000")):
            bits = [int(digit) >> bit & 1 for bit in (2, 1, 0)]
            for column in (number for number, bit in enumerate(bits) if bit):
                top, left = _SCALE * (1 + row), at + _SCALE * column
                pixels[top : top + _SCALE, left : left + _SCALE] = colour
        at += 4 * _SCALE


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
